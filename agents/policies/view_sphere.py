"""What policies may ask an environment: where its actions would send the camera, and no truth."""

from __future__ import annotations

import math
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from ...core.errors import InputError
from ...envs.actions import AZIMUTH_LIMIT
from ...envs.observation import SpherePosition
from ...envs.simulation.camera import CAMERA_RANGE
from ...envs.simulation.carrier import camera_center
from ...envs.two_view_pose import CANDIDATE_VIEWS
from ...pose_estimator.types import PoseEstimate

Action = np.ndarray | int


class ViewSphere(Protocol):
    """An environment in which views are chosen around an estimated object."""

    action_space: spaces.Space[Any]

    @property
    def reference_position(self) -> SpherePosition: ...
    @property
    def sphere_center(self) -> np.ndarray: ...
    @property
    def T_cam_world(self) -> np.ndarray: ...
    @property
    def intrinsics(self) -> np.ndarray: ...
    @property
    def estimate(self) -> PoseEstimate | None: ...
    @property
    def travel_weight(self) -> float: ...
    def camera_pose(self, action: Any) -> np.ndarray: ...


def check_view_sphere(env: gym.Env) -> Any:
    """The unwrapped environment, if it has a view sphere.

    Raises:
        InputError: if it has none.
    """
    check_space(env.action_space)
    inner: Any = env.unwrapped
    if not hasattr(inner, "camera_pose"):
        raise InputError(
            "this policy needs an environment with a view sphere (camera_pose, "
            f"reference_position, sphere_center), got {type(inner).__name__}"
        )
    return inner


def check_space(space: spaces.Space[Any]) -> spaces.Box | spaces.Discrete:
    """The space, if it is one that the baselines act in.

    Raises:
        InputError: if it is another.
    """
    if not isinstance(space, spaces.Box | spaces.Discrete):
        raise InputError(f"baselines act in a Box or a Discrete space, got {space}")
    return space


def view_actions(env: ViewSphere) -> list[Any]:
    """The views to choose from: all of a list, or in a Box the places of `CANDIDATE_VIEWS`.

    The action that stops is no view.
    """
    if isinstance(env.action_space, spaces.Discrete):
        return list(range(getattr(env, "stop_action", int(env.action_space.n))))
    return [box_action(env, *np.deg2rad(view)) for view in CANDIDATE_VIEWS]


def camera_poses(env: ViewSphere, actions: list[Any]) -> np.ndarray:
    """Where actions would send the camera: T_cam_world (N, 4, 4)."""
    return np.stack([env.camera_pose(action) for action in actions])


def view_directions(env: ViewSphere, actions: list[Any]) -> np.ndarray:
    """From the object to the cameras of actions, (N, 3) meters, world."""
    return camera_center(camera_poses(env, actions)) - env.sphere_center


def travels(env: ViewSphere, actions: list[Any]) -> np.ndarray:
    """Straight ways from the newest camera to those of actions, (N,) meters."""
    newest = getattr(env, "T_newest_world", env.T_cam_world)
    start = camera_center(newest) - env.sphere_center
    return np.linalg.norm(view_directions(env, actions) - start, axis=1)


def box_action(env: ViewSphere, azimuth: float, elevation: float) -> np.ndarray:
    """The action of the Box that goes to an offset and an elevation at the reference's distance."""
    wanted = (azimuth, elevation, env.reference_position.distance)
    limits = ((-AZIMUTH_LIMIT, AZIMUTH_LIMIT), CAMERA_RANGE.elevation, CAMERA_RANGE.distance)
    units = [
        2.0 * (value - low) / (high - low) - 1.0
        for value, (low, high) in zip(wanted, limits, strict=True)
    ]
    return np.clip(units, -1.0, 1.0).astype(np.float32)


def direction(azimuth: float, elevation: float) -> np.ndarray:
    """Unit vector (3,) from the object to a camera on the view sphere."""
    flat = math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two vectors (3,), radians."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
