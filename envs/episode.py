"""The record of one episode: its target, views, estimates and errors."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..assets.object_model import ObjectModel
from ..core.geometry import View, check_rigid, invert
from ..pose_estimator.evaluation.metrics import add_or_add_s
from ..pose_estimator.types import PoseEstimate
from .observation import SpherePosition
from .simulation.carrier import angle_at

WORKSPACE_LOW, WORKSPACE_HIGH = np.array([-0.5, -0.5, 0.0]), np.array([0.5, 0.5, 0.4])
"""Where objects stand on the table (world, meters); bounds the view sphere's center."""


@dataclass(eq=False)
class Episode:
    """One target in one scene, and the views of it so far.

    Attributes:
        scene_seed: seed of everything random in the episode.
        object_name: the target.
        model: of the target.
        T_world_obj: its true pose, (4, 4).
        visibility: visible fraction of the target in the reference view.
        noise_rng: samples the noise of the estimator's camera poses.
        cameras: true T_cam_world of each view, the reference view first, (4, 4).
        views: the estimator's input, the reference view first.
        estimates: the estimate after each view; empty without an estimator.
        errors: ADD(-S) of each estimate, meters.
        travel: path length of the camera since the reference view, meters.
        ended: whether the last view has been taken.
    """

    scene_seed: int
    object_name: str
    model: ObjectModel
    T_world_obj: np.ndarray
    visibility: float
    noise_rng: np.random.Generator
    cameras: list[np.ndarray] = field(default_factory=list)
    views: list[View] = field(default_factory=list)
    estimates: list[PoseEstimate] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    travel: float = 0.0
    ended: bool = False

    def copy(self) -> Episode:
        """Copies the episode; images and estimates are shared."""
        names = ("cameras", "views", "estimates", "errors")
        lists: dict[str, Any] = {name: list(getattr(self, name)) for name in names}
        return replace(self, noise_rng=deepcopy(self.noise_rng), **lists)

    def add_estimate(self, estimate: PoseEstimate) -> None:
        """Adds the estimate from all views so far, and its error.

        Raises:
            InputError: if its pose is not a rigid transform.
        """
        check_rigid(estimate.T_cam_obj, "the estimator's T_cam_obj")
        error = add_or_add_s(estimate.T_cam_obj, self.T_cam_obj_true(0), self.model)
        self.estimates.append(estimate)
        self.errors.append(error)

    def T_cam_obj_true(self, index: int) -> np.ndarray:
        """The true pose in the camera of a view, (4, 4)."""
        return self.cameras[index] @ self.T_world_obj

    @property
    def sphere_center(self) -> np.ndarray:
        """Center of the view sphere, (3,), world: the first estimated position of the object.

        It is clipped to the workspace on the table. Without an estimate it is the intersection of
        the reference camera's optical axis with the table.
        """
        T_world_cam = invert(self.cameras[0])
        if self.estimates:
            center = (T_world_cam @ self.estimates[0].T_cam_obj)[:3, 3]
        else:
            origin, axis = T_world_cam[:3, 3], T_world_cam[:3, 2]
            center = origin + axis * (origin[2] / max(-axis[2], 1e-3))
        return np.clip(center, WORKSPACE_LOW, WORKSPACE_HIGH)

    def position(self, index: int) -> SpherePosition:
        """The camera of a view in spherical coordinates about the view sphere's center."""
        return SpherePosition.of(self.cameras[index], self.sphere_center)

    @property
    def baseline_deg(self) -> float:
        """Angle at the view sphere's center between the first and the latest camera."""
        return angle_at(self.sphere_center, self.cameras[0], self.cameras[-1])

    @property
    def estimate(self) -> PoseEstimate | None:
        """The latest estimate; None without an estimator."""
        return self.estimates[-1] if self.estimates else None

    @property
    def diameter(self) -> float:
        """Diameter of the target, meters."""
        return float(self.model.diameter)

    @property
    def error_ratio(self) -> float:
        """The latest error in diameters, clipped to 1; 0 without an estimator."""
        return min(self.errors[-1] / self.diameter, 1.0) if self.errors else 0.0

    def info(self) -> dict[str, Any]:
        """The environment's info; agents must not use ``ground_truth``."""
        estimate = self.estimate
        return {
            "object": self.object_name,
            "diameter": self.diameter,
            "scene_seed": self.scene_seed,
            "T_cam_world": self.cameras[-1].copy(),
            "T_cam_obj": np.zeros((4, 4)) if estimate is None else estimate.T_cam_obj.copy(),
            "travel": self.travel,
            "baseline_deg": self.baseline_deg,
            "ground_truth": {
                "T_cam_obj": self.T_cam_obj_true(0),
                **ground_truth(self.visibility, self.errors, self.diameter),
            },
        }


def ground_truth(visibility: float, errors: Sequence[float], diameter: float) -> dict[str, Any]:
    """The ground truth in the info of live and of replayed episodes, see :class:`Episode`."""
    truth: dict[str, Any] = {"visibility": visibility}
    if errors:
        truth["add_first"] = errors[0]
        truth["success"] = bool(errors[-1] < 0.1 * diameter)
    if len(errors) > 1:
        truth["add_second"] = errors[-1]
    return truth


def episode_seed(seed: int, number: int) -> int:
    """The seed of ``reset`` for episode ``number`` of a series."""
    return int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0])
