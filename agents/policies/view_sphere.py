"""What policies may ask an environment: cameras after its actions, no ground truth."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from ...core.errors import InputError
from ...envs.actions import AZIMUTH_LIMIT
from ...envs.base import ViewSelectionEnv
from ...envs.simulation.camera import CAMERA_RANGE
from ...envs.simulation.carrier import camera_center
from ...envs.two_view_pose import CANDIDATE_VIEWS

Action = np.ndarray | int


def check_view_sphere(env: gym.Env) -> Any:
    """Returns the unwrapped environment; raises InputError if it has no view sphere."""
    check_action_space(env.action_space)
    inner: Any = env.unwrapped
    if not hasattr(inner, "camera_pose"):
        raise InputError(
            "this policy needs an environment with a view sphere (camera_pose, "
            f"reference_position, sphere_center), got {type(inner).__name__}"
        )
    return inner


def check_action_space(space: spaces.Space[Any]) -> spaces.Box | spaces.Discrete:
    """Returns the space; raises InputError unless it is a Box or Discrete."""
    if not isinstance(space, spaces.Box | spaces.Discrete):
        raise InputError(f"action space must be Box or Discrete, got {space}")
    return space


def candidate_actions(env: ViewSelectionEnv) -> list[Any]:
    """All views of a Discrete space, without the stop action, or in a Box `CANDIDATE_VIEWS`."""
    if isinstance(env.action_space, spaces.Discrete):
        return list(range(getattr(env, "stop_action", int(env.action_space.n))))
    return [box_action(env, *np.deg2rad(view)) for view in CANDIDATE_VIEWS]


def camera_poses(env: ViewSelectionEnv, actions: list[Any]) -> np.ndarray:
    """Cameras after the actions, T_cam_world (N, 4, 4)."""
    return np.stack([env.camera_pose(action) for action in actions])


def view_directions(env: ViewSelectionEnv, actions: list[Any]) -> np.ndarray:
    """Vectors from the object to the cameras after the actions, (N, 3) meters, world."""
    return camera_center(camera_poses(env, actions)) - env.sphere_center


def travel_distances(env: ViewSelectionEnv, actions: list[Any]) -> np.ndarray:
    """Straight-line distances from the newest camera to those of the actions, (N,) meters."""
    newest = getattr(env, "T_newest_world", env.T_cam_world)
    start = camera_center(newest) - env.sphere_center
    return np.linalg.norm(view_directions(env, actions) - start, axis=1)


def box_action(env: ViewSelectionEnv, azimuth: float, elevation: float) -> np.ndarray:
    """The Box action for an azimuth offset and an elevation at the reference camera's distance."""
    target = (azimuth, elevation, env.reference_position.distance)
    limits = ((-AZIMUTH_LIMIT, AZIMUTH_LIMIT), CAMERA_RANGE.elevation, CAMERA_RANGE.distance)
    units = [
        2.0 * (value - low) / (high - low) - 1.0
        for value, (low, high) in zip(target, limits, strict=True)
    ]
    return np.clip(units, -1.0, 1.0).astype(np.float32)


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two vectors (3,), radians."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
