"""Policies that learn nothing: what a trained one has to beat.

A policy has ``name``, ``reset(rng)`` (once an episode, after the environment's own reset) and
``act(observation)``. ``fixed`` and ``max-baseline`` ask the environment where an action would send
the camera; they know the estimated object and the robot's own camera pose, no ground truth.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from itertools import product
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from ..envs.base import CAMERA_RANGE
from ..envs.carrier import camera_centre
from ..envs.observation import SpherePosition
from ..envs.two_view_pose import AZIMUTH_LIMIT

Action = np.ndarray | int

FIXED_AZIMUTH = math.radians(30.0)
"""How far to the side the ``fixed`` policy looks from, radians."""


class Policy(Protocol):
    """Whatever chooses the second view."""

    name: str

    def reset(self, rng: np.random.Generator) -> None:
        """Begins an episode; what the policy draws, it draws from ``rng``."""
        ...

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """Chooses an action of the environment's action space."""
        ...


class ViewSphere(Protocol):
    """What ``fixed`` and ``max-baseline`` need of an environment."""

    action_space: spaces.Space[Any]

    @property
    def reference_position(self) -> SpherePosition: ...
    @property
    def sphere_centre(self) -> np.ndarray: ...
    def camera_pose(self, action: Any) -> np.ndarray: ...


class RandomPolicy:
    """Every action is as likely as every other."""

    name = "random"

    def __init__(self, env: gym.Env) -> None:
        self._space = _check_space(env.action_space)
        self._rng = np.random.default_rng(0)

    def reset(self, rng: np.random.Generator) -> None:
        """Draws from ``rng`` from now on."""
        self._rng = rng

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """Draws an action."""
        if isinstance(self._space, spaces.Discrete):
            return int(self._space.start + self._rng.integers(self._space.n))
        low, high = self._space.low, self._space.high
        return self._rng.uniform(low, high).astype(self._space.dtype)


class FixedPolicy:
    """30 degrees to the side at the same elevation and distance, or the candidate nearest to it."""

    name = "fixed"

    def __init__(self, env: gym.Env) -> None:
        self._env = _check_view_sphere(env)

    def reset(self, rng: np.random.Generator) -> None:
        """Nothing to do: the policy draws nothing."""

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """The same motion whatever the observation."""
        elevation = self._env.reference_position.elevation
        if isinstance(self._env.action_space, spaces.Box):
            return _box_action(self._env, FIXED_AZIMUTH, elevation)
        azimuth = self._env.reference_position.azimuth + FIXED_AZIMUTH
        wanted = _direction(azimuth, elevation)
        return _best(self._env, range(self._env.action_space.n), lambda d: -_angle(d, wanted))


class MaxBaselinePolicy:
    """The view whose direction from the object is farthest in angle from the reference view's.

    With an azimuth offset of at most 90 degrees the cosine of that angle is, for both elevations
    above the horizon, a concave function of the second elevation and falls with the offset: its
    least value is at a corner of the box.
    """

    name = "max-baseline"

    def __init__(self, env: gym.Env) -> None:
        self._env = _check_view_sphere(env)

    def reset(self, rng: np.random.Generator) -> None:
        """Nothing to do: the policy draws nothing."""

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """The farthest view of this episode; of two equally far ones the first."""
        reference = self._env.reference_position
        if isinstance(self._env.action_space, spaces.Box):
            corners = product((AZIMUTH_LIMIT, -AZIMUTH_LIMIT), CAMERA_RANGE.elevation)
            actions: Any = [_box_action(self._env, *corner) for corner in corners]
        else:
            actions = range(self._env.action_space.n)
        seen_from = _direction(reference.azimuth, reference.elevation)
        return _best(self._env, actions, lambda direction: _angle(direction, seen_from))


BASELINES: dict[str, Callable[[gym.Env], Policy]] = {
    policy.name: policy for policy in (RandomPolicy, FixedPolicy, MaxBaselinePolicy)
}


def make_policy(name_or_path: str | os.PathLike[str], env: gym.Env) -> Policy:
    """Makes a policy that acts in ``env``.

    Args:
        name_or_path: ``random``, ``fixed``, ``max-baseline``, or a file that ``train-agent`` wrote.
        env: the environment; ``fixed`` and ``max-baseline`` ask it about the running episode.

    Raises:
        ValueError: if it is neither, or the file is damaged or of other spaces than ``env``'s.
    """
    if name_or_path in BASELINES:
        return BASELINES[os.fspath(name_or_path)](env)
    if not os.path.isfile(name_or_path):
        raise ValueError(
            f"policy must be {', '.join(BASELINES)} or a file that train-agent wrote; "
            f"got {os.fspath(name_or_path)!r}, which is no file"
        )
    from .trained import load_policy  # imports torch: only now

    return load_policy(name_or_path, env)


def _box_action(env: ViewSphere, azimuth: float, elevation: float) -> np.ndarray:
    """The action of the Box that goes to an offset and an elevation at the reference's distance."""
    wanted = (azimuth, elevation, env.reference_position.distance)
    limits = ((-AZIMUTH_LIMIT, AZIMUTH_LIMIT), CAMERA_RANGE.elevation, CAMERA_RANGE.distance)
    units = [
        2.0 * (value - low) / (high - low) - 1.0
        for value, (low, high) in zip(wanted, limits, strict=True)
    ]
    return np.clip(units, -1.0, 1.0).astype(np.float32)


def _best(env: ViewSphere, actions: Any, score: Callable[[np.ndarray], float]) -> Action:
    """The first action whose view direction has the highest score, but for rounding."""
    directions = [camera_centre(env.camera_pose(action)) - env.sphere_centre for action in actions]
    scores = np.array([score(direction) for direction in directions])
    return actions[int(np.argmax(scores > scores.max() - 1e-6))]


def _direction(azimuth: float, elevation: float) -> np.ndarray:
    """Unit vector (3,) from the object to a camera on the view sphere."""
    flat = math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two vectors (3,), radians."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


def _check_space(space: spaces.Space[Any]) -> spaces.Box | spaces.Discrete:
    if not isinstance(space, spaces.Box | spaces.Discrete):
        raise ValueError(f"baselines act in a Box or a Discrete space, got {space}")
    return space


def _check_view_sphere(env: gym.Env) -> Any:
    """The unwrapped environment, if it has a view sphere."""
    _check_space(env.action_space)
    inner: Any = env.unwrapped
    if not hasattr(inner, "camera_pose"):
        raise ValueError(
            "fixed and max-baseline need an environment with a view sphere (camera_pose, "
            f"reference_position, sphere_centre), got {type(inner).__name__}"
        )
    return inner
