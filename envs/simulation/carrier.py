"""Camera motion, and the error of the camera poses that the estimator is given.

The environment moves its camera through a carrier. The default one reaches every pose; a robot arm
with reach and joint limits is another class with the same two methods.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from ...core.errors import InputError
from ...core.geometry import check_rigid, make_transform
from ...core.validation import require_within
from .camera import camera_center


@dataclass(frozen=True)
class PoseNoise:
    """Noise of the relative camera pose that the estimator is given (hand-eye calibration).

    Attributes:
        rotation_deg: standard deviation of the rotation about each axis, degrees.
        translation: standard deviation along each axis, meters.
    """

    rotation_deg: float = 0.0
    translation: float = 0.0

    def __post_init__(self) -> None:
        require_within(self, 0, np.inf, "rotation_deg", "translation", prefix="pose_noise.")

    @classmethod
    def of(cls, noise: PoseNoise | tuple[float, float] | None) -> PoseNoise:
        """Reads the environment's argument: a ``PoseNoise``, (degrees, meters) or None.

        Raises:
            InputError: if it is none of these.
        """
        if noise is None:
            return cls()
        if isinstance(noise, cls):
            return noise
        if isinstance(noise, tuple | list) and len(noise) == 2:
            return cls(*noise)
        raise InputError(
            f"pose_noise must be a PoseNoise, a pair (degrees, meters) or None, got {noise!r}"
        )

    def perturb(self, T_cam_world: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Returns a noisy camera pose (4, 4); always takes six draws from ``rng``."""
        draws = rng.standard_normal(6)
        rotation = Rotation.from_rotvec(np.deg2rad(self.rotation_deg) * draws[:3])
        return make_transform(rotation.as_matrix(), self.translation * draws[3:]) @ T_cam_world


@dataclass(frozen=True, eq=False)
class Motion:
    """Result of a camera motion.

    Attributes:
        T_cam_world: the pose that was reached, (4, 4).
        travel: path length of the camera center, meters.
    """

    T_cam_world: np.ndarray
    travel: float


class Carrier(Protocol):
    """Moves the camera from one view to the next."""

    def place(self, T_cam_world: np.ndarray) -> None:
        """Starts an episode with the camera at ``T_cam_world`` (4, 4)."""
        ...

    def move(self, T_cam_world: np.ndarray) -> Motion:
        """Moves the camera to ``T_cam_world`` (4, 4), or as close as the carrier can get."""
        ...


class FreeFlyingCarrier:
    """Reaches every pose, along the straight line between the two camera centers."""

    def __init__(self) -> None:
        self._T_cam_world = np.eye(4)

    def place(self, T_cam_world: np.ndarray) -> None:
        """Starts an episode; an InputError if the pose is not a rigid transform."""
        self._T_cam_world = check_rigid(T_cam_world, "T_cam_world").copy()

    def move(self, T_cam_world: np.ndarray) -> Motion:
        """Moves the camera; an InputError if the pose is not a rigid transform."""
        start = camera_center(self._T_cam_world)
        self.place(T_cam_world)
        travel = float(np.linalg.norm(camera_center(self._T_cam_world) - start))
        return Motion(self._T_cam_world.copy(), travel)


def angle_at(center: np.ndarray, T_cam_world: np.ndarray, T_other_world: np.ndarray) -> float:
    """Returns the angle in degrees at ``center`` (3,) between two cameras (4, 4)."""
    first, last = camera_center(T_cam_world) - center, camera_center(T_other_world) - center
    sine, cosine = np.linalg.norm(np.cross(first, last)), first @ last
    return float(np.rad2deg(np.arctan2(sine, cosine)))


def directions_from(center: np.ndarray, T_cam_world: np.ndarray) -> np.ndarray:
    """Returns unit vectors (..., 3) from world points (..., 3) to cameras (..., 4, 4)."""
    offset = camera_center(T_cam_world) - center
    return offset / np.linalg.norm(offset, axis=-1, keepdims=True)
