"""Agents that choose the second view.

``policies`` holds one policy a file and ``registry.py``, which makes them by name; ``networks`` the
error predictor, SB3's feature extractor and the agent file format; ``training`` the command
``train-agent`` (Stable-Baselines3 or supervised error regression); ``evaluation`` the commands
``evaluate-agent`` and ``demo``. Importing this package imports neither torch nor SB3.
"""
