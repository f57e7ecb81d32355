"""Policies: ``reset(rng)`` once per episode, ``act(observation)`` for each view.

``registry.make_policy`` makes one by name or from a file. ``baselines.py`` has those that learn
nothing, ``uncertainty.py`` the Fisher-information rule, ``oracle.py`` the upper bound,
``greedy.py`` the error predictor and ``trained.py`` those of Stable-Baselines3. ``view_sphere.py``
is what a policy may ask the environment.
"""
