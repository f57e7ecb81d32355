"""What is remembered of one episode."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..pose_estimator.estimate import PoseEstimate
from ..pose_estimator.geometry import View, invert
from .carrier import angle_at
from .observation import SpherePosition

WORKSPACE_LOW, WORKSPACE_HIGH = np.array([-0.5, -0.5, 0.0]), np.array([0.5, 0.5, 0.4])
"""Where on the table the object can be at all (world, metres); bounds the view sphere's centre."""


@dataclass(eq=False)
class Episode:
    """One target in one scene, and the views of it so far.

    Attributes:
        scene_seed: everything drawn in the episode follows from it.
        object_name: the target.
        T_world_obj: its true pose, (4, 4).
        visibility: visible fraction of the target in the reference view.
        noise_rng: draws the error of the camera poses that the estimator is told.
        T_reference_world: the reference camera, (4, 4).
        cameras: true T_cam_world of each view, (4, 4).
        views: what the estimator was given, the reference view first.
        estimates: the answer after each view; empty without an estimator.
        errors: ADD(-S) of each estimate, metres.
        travel: how far the camera has moved since the reference view, metres.
        ended: whether the last view has been taken.
    """

    scene_seed: int
    object_name: str
    T_world_obj: np.ndarray
    visibility: float
    noise_rng: np.random.Generator
    T_reference_world: np.ndarray
    cameras: list[np.ndarray] = field(default_factory=list)
    views: list[View] = field(default_factory=list)
    estimates: list[PoseEstimate] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    travel: float = 0.0
    ended: bool = False

    def copy(self) -> Episode:
        """The same episode, which may go on another way; pictures and estimates are shared."""
        return replace(
            self,
            noise_rng=deepcopy(self.noise_rng),
            cameras=list(self.cameras),
            views=list(self.views),
            estimates=list(self.estimates),
            errors=list(self.errors),
        )

    def T_cam_obj_true(self, index: int) -> np.ndarray:
        """The true pose in the camera of a view, (4, 4), a new array."""
        return self.cameras[index] @ self.T_world_obj

    @property
    def sphere_centre(self) -> np.ndarray:
        """The middle of the view sphere, (3,), world: where the object is estimated to be.

        It is kept within the part of the table where objects stand. Without an estimate it is
        where the reference camera's optical axis meets the table.
        """
        T_world_cam = invert(self.cameras[0])
        if self.estimates:
            centre = (T_world_cam @ self.estimates[0].T_cam_obj)[:3, 3]
        else:
            origin, axis = T_world_cam[:3, 3], T_world_cam[:3, 2]
            centre = origin + axis * (origin[2] / max(-axis[2], 1e-3))
        return np.clip(centre, WORKSPACE_LOW, WORKSPACE_HIGH)

    def position(self, index: int) -> SpherePosition:
        """The camera of a view, as seen from the middle of the view sphere."""
        return SpherePosition.of(self.cameras[index], self.sphere_centre)

    @property
    def baseline_deg(self) -> float:
        """Angle at the middle of the view sphere between the first and the newest camera."""
        return angle_at(self.sphere_centre, self.cameras[0], self.cameras[-1])

    def reward(self, diameter: float, travel_weight: float) -> float:
        """Minus the newest error in diameters (at most 1), minus the price of the travel.

        Args:
            diameter: of the target, metres.
            travel_weight: price of a metre of camera travel.
        """
        error = min(self.errors[-1] / diameter, 1.0) if self.errors else 0.0
        return float(-error - travel_weight * self.travel)

    def info(self, diameter: float) -> dict[str, Any]:
        """What the environment says of the episode beside its observation.

        Args:
            diameter: of the target, metres.
        """
        estimate = self.estimates[-1] if self.estimates else None
        truth: dict[str, Any] = {
            "T_cam_obj": self.T_cam_obj_true(0),
            "visibility": self.visibility,
        }
        if self.errors:
            truth["add_first"] = self.errors[0]
            truth["success"] = bool(self.errors[-1] < 0.1 * diameter)
        if len(self.errors) > 1:
            truth["add_second"] = self.errors[-1]
        return {
            "object": self.object_name,
            "diameter": diameter,
            "scene_seed": self.scene_seed,
            "T_cam_world": self.cameras[-1].copy(),
            "T_cam_obj": np.zeros((4, 4)) if estimate is None else estimate.T_cam_obj.copy(),
            "travel": self.travel,
            "baseline_deg": self.baseline_deg,
            "ground_truth": truth,
        }


def episode_seed(seed: int, number: int) -> int:
    """The seed of ``reset`` for episode ``number`` of a study, the same wherever it runs."""
    return int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0])
