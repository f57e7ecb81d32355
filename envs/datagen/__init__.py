"""The command ``generate``: renders training and test data in BOP format.

``config.py`` has the options, ``generate.py`` the steps of a run. ``scene_plan.py`` decides what
each scene is, ``scene_writer.py`` renders it, ``pair_list.py`` lists the two-view pairs, and
``checksums.py`` verifies a dataset.
"""
