"""What is remembered of one episode."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..pose_estimator.estimate import PoseEstimate
from ..pose_estimator.geometry import View
from .carrier import angle_at


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

    def info(self, diameter: float, centre: np.ndarray) -> dict[str, Any]:
        """What the environment says of the episode beside its observation.

        Args:
            diameter: of the target, metres.
            centre: of the view sphere, (3,), world.
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
            "baseline_deg": self.baseline_deg(centre),
            "ground_truth": truth,
        }

    def baseline_deg(self, centre: np.ndarray) -> float:
        """Angle at ``centre`` (3,) between the directions to the first and the newest camera."""
        return angle_at(centre, self.cameras[0], self.cameras[-1])


def episode_seed(seed: int, number: int) -> int:
    """The seed of ``reset`` for episode ``number`` of a study, the same wherever it runs."""
    return int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0])
