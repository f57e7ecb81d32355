"""Agents that choose the second view: baselines, SB3 training, evaluation.

Importing this package imports neither torch nor Stable-Baselines3.
"""
