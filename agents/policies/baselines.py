"""Baseline policies, which learn nothing.

``fixed`` and ``max-baseline`` ask the environment where an action would send the camera. They know
the estimated object and the robot's own camera pose, no ground truth.
"""

import math
from collections.abc import Callable, Mapping
from itertools import product
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from ...envs.actions import AZIMUTH_LIMIT
from ...envs.simulation.camera import CAMERA_RANGE, sphere_direction
from .view_sphere import (
    Action,
    angle_between,
    box_action,
    candidate_actions,
    check_action_space,
    check_view_sphere,
    view_directions,
)

FIXED_AZIMUTH = math.radians(30.0)
"""Azimuth offset of the ``fixed`` policy, radians."""


class Policy(Protocol):
    """Chooses the second view."""

    def reset(self, rng: np.random.Generator) -> None:
        """Starts an episode, after the environment's reset; random choices draw from ``rng``."""
        return

    def act(self, observation: Mapping[str, np.ndarray]) -> Action | None:
        """Returns an action of the environment's action space, or None for no (further) view."""
        ...


class ViewSpherePolicy(Policy):
    """A policy that queries the view sphere of its environment; InputError if it has none."""

    def __init__(self, env: gym.Env) -> None:
        self._env = check_view_sphere(env)

    def _best(self, actions: list[Any], score: Callable[[np.ndarray], float]) -> Action:
        """The first action whose view direction has the highest score, up to rounding."""
        scores = np.array([score(d) for d in view_directions(self._env, actions)])
        return actions[int(np.argmax(scores > scores.max() - 1e-6))]


class StayPolicy(Policy):
    """No second view: the estimate from the first view alone."""

    def __init__(self, env: gym.Env) -> None:
        pass

    def act(self, observation: Mapping[str, np.ndarray]) -> None:
        """Returns None."""


class RandomPolicy(Policy):
    """Chooses uniformly among all views."""

    def __init__(self, env: gym.Env) -> None:
        self._space = check_action_space(env.action_space)
        # The stop action is not a view.
        self._views = getattr(env.unwrapped, "stop_action", getattr(self._space, "n", 0))
        self._rng = np.random.default_rng(0)

    def reset(self, rng: np.random.Generator) -> None:
        """Uses ``rng`` from now on."""
        self._rng = rng

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """Samples an action."""
        if isinstance(self._space, spaces.Discrete):
            return int(self._space.start + self._rng.integers(self._views))
        return self._rng.uniform(self._space.low, self._space.high).astype(self._space.dtype)


class FixedPolicy(ViewSpherePolicy):
    """30 degrees to the side at the same elevation and distance, or the nearest candidate."""

    elevation: float | None = None
    """Elevation of the second view, radians; None: the reference camera's."""

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """Returns the same motion for every observation."""
        reference = self._env.reference_position
        elevation = reference.elevation if self.elevation is None else self.elevation
        if isinstance(self._env.action_space, spaces.Box):
            return box_action(self._env, FIXED_AZIMUTH, elevation)
        target = sphere_direction(reference.azimuth + FIXED_AZIMUTH, elevation)
        return self._best(candidate_actions(self._env), lambda d: -angle_between(d, target))


class AbovePolicy(FixedPolicy):
    """30 degrees to the side and from 70 degrees elevation, over most occluders."""

    elevation = math.radians(70.0)


class MaxBaselinePolicy(ViewSpherePolicy):
    """The view whose direction from the object is farthest in angle from the reference view's.

    With an azimuth offset of at most 90 degrees the cosine of that angle is, for both elevations
    above the horizon, a concave function of the second elevation and falls with the offset: its
    minimum is at a corner of the box.
    """

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """Returns the farthest view of this episode; of two equally far ones the first."""
        reference = self._env.reference_position
        if isinstance(self._env.action_space, spaces.Box):
            corners = product((AZIMUTH_LIMIT, -AZIMUTH_LIMIT), CAMERA_RANGE.elevation)
            actions: list[Any] = [box_action(self._env, *corner) for corner in corners]
        else:
            actions = candidate_actions(self._env)
        first = sphere_direction(reference.azimuth, reference.elevation)
        return self._best(actions, lambda d: angle_between(d, first))
