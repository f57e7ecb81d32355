"""Policies that learn nothing: what a trained one has to beat.

A policy has ``reset(rng)`` (once an episode, after the environment's own reset) and
``act(observation)``. ``fixed`` and ``max-baseline`` ask the environment where an action would send
the camera; they know the estimated object and the robot's own camera pose, no ground truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import product
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from ...envs.actions import AZIMUTH_LIMIT
from ...envs.simulation.camera import CAMERA_RANGE
from .view_sphere import (
    Action,
    ViewSphere,
    angle,
    box_action,
    check_space,
    check_view_sphere,
    direction,
    view_actions,
    view_directions,
)

FIXED_AZIMUTH = math.radians(30.0)
"""How far to the side the ``fixed`` policy looks from, radians."""


class Policy(Protocol):
    """Whatever chooses the second view."""

    def reset(self, rng: np.random.Generator) -> None:
        """Begins an episode; what the policy draws, it draws from ``rng``. Most draw nothing."""
        return

    def act(self, observation: Mapping[str, np.ndarray]) -> Action | None:
        """Chooses an action of the environment's action space; None: no (further) view."""
        ...


class ViewSpherePolicy(Policy):
    """A policy that asks the environment about the views around the estimated object.

    Args:
        env: an environment with a view sphere.

    Raises:
        InputError: if it has none.
    """

    def __init__(self, env: gym.Env) -> None:
        self._env = check_view_sphere(env)


class StayPolicy(Policy):
    """No second view: what the first one alone gives."""

    def __init__(self, env: gym.Env) -> None:
        pass

    def act(self, observation: Mapping[str, np.ndarray]) -> None:
        """No view."""


class RandomPolicy(Policy):
    """Every view is as likely as every other."""

    def __init__(self, env: gym.Env) -> None:
        self._space = check_space(env.action_space)
        # The action that stops is no view.
        self._views = getattr(env.unwrapped, "stop_action", getattr(self._space, "n", 0))
        self._rng = np.random.default_rng(0)

    def reset(self, rng: np.random.Generator) -> None:
        """Draws from ``rng`` from now on."""
        self._rng = rng

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """Draws an action."""
        if isinstance(self._space, spaces.Discrete):
            return int(self._space.start + self._rng.integers(self._views))
        low, high = self._space.low, self._space.high
        return self._rng.uniform(low, high).astype(self._space.dtype)


class FixedPolicy(ViewSpherePolicy):
    """30 degrees to the side at the same elevation and distance, or the candidate nearest to it."""

    elevation: float | None = None
    """The elevation to look from, radians; None: the reference camera's."""

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """The same motion whatever the observation."""
        reference = self._env.reference_position
        elevation = reference.elevation if self.elevation is None else self.elevation
        if isinstance(self._env.action_space, spaces.Box):
            return box_action(self._env, FIXED_AZIMUTH, elevation)
        wanted = direction(reference.azimuth + FIXED_AZIMUTH, elevation)
        return _best(self._env, view_actions(self._env), lambda d: -angle(d, wanted))


class AbovePolicy(FixedPolicy):
    """As far to the side, and from 70 degrees above the table: over most occluders."""

    elevation = math.radians(70.0)


class MaxBaselinePolicy(ViewSpherePolicy):
    """The view whose direction from the object is farthest in angle from the reference view's.

    With an azimuth offset of at most 90 degrees the cosine of that angle is, for both elevations
    above the horizon, a concave function of the second elevation and falls with the offset: its
    least value is at a corner of the box.
    """

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """The farthest view of this episode; of two equally far ones the first."""
        reference = self._env.reference_position
        if isinstance(self._env.action_space, spaces.Box):
            corners = product((AZIMUTH_LIMIT, -AZIMUTH_LIMIT), CAMERA_RANGE.elevation)
            actions: Any = [box_action(self._env, *corner) for corner in corners]
        else:
            actions = view_actions(self._env)
        seen_from = direction(reference.azimuth, reference.elevation)
        return _best(self._env, actions, lambda d: angle(d, seen_from))


def _best(env: ViewSphere, actions: Any, score: Callable[[np.ndarray], float]) -> Action:
    """The first action whose view direction has the highest score, but for rounding."""
    scores = np.array([score(d) for d in view_directions(env, actions)])
    return actions[int(np.argmax(scores > scores.max() - 1e-6))]
