"""The simulator: MuJoCo scenes of objects on a table, rendered and randomized.

``scene_kinds.py`` is the table of scene kinds; ``scene.py`` sets up a scene, which ``clutter.py``
and ``heap.py`` arrange. ``world.py`` compiles the model, ``renderer.py`` renders it. ``sensor.py``
and ``depth_sensor.py`` are the noise models, ``randomization.py`` is domain randomization.
``simulator.py`` is the interface of the environments, ``trajectories/`` the cameras of datasets.
"""
