"""Soft RANSAC beside what OpenCV offers for the same nine keypoints: how quick, and how robust."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from scipy.spatial.transform import Rotation

from .geometry import LINEMOD_K, project
from .solvers import SOLVER_INLIER, solve

_BATCH = 32
_OUTLIERS = 3
_RIGHT = 0.1
"""Mean distance of the keypoints in diameters below which a pose is right, as for ADD."""


@dataclass(frozen=True, eq=False)
class KeypointProblems:
    """Poses to be found from keypoints.

    Attributes:
        model_points: (9, 3), object's frame, metres.
        diameter: metres.
        true: the keypoints in the camera's frame, (B, 9, 3), metres.
        predicted: what was found of them, (B, 9, 3), metres.
    """

    model_points: np.ndarray
    diameter: float
    true: np.ndarray
    predicted: np.ndarray


def draw_problems(
    rng: np.random.Generator, count: int, *, deviation: float = 0.005, outliers: int = 0
) -> KeypointProblems:
    """Draws poses about a metre away, of an object of LineMOD's size.

    Args:
        rng: where everything is drawn from.
        count: how many poses.
        deviation: standard deviation of the keypoints in metres, along each axis.
        outliers: how many of the nine keypoints lie anywhere within two diameters instead.
    """
    diameter = 0.2
    model_points = rng.normal(size=(9, 3))
    model_points *= 0.5 * diameter / np.linalg.norm(model_points, axis=1, keepdims=True)
    model_points[-1] = 0.0
    rotations = Rotation.random(count, rng=rng).as_matrix()
    translations = rng.uniform((-0.1, -0.1, 0.7), (0.1, 0.1, 1.2), (count, 3))
    true = model_points @ rotations.transpose(0, 2, 1) + translations[:, None]
    predicted = true + rng.normal(0, deviation, true.shape)
    if outliers:
        wrong = rng.permuted(np.tile(np.arange(9), (count, 1)), axis=1)[:, :outliers]
        anywhere = rng.uniform(-2 * diameter, 2 * diameter, (count, outliers, 3))
        np.put_along_axis(predicted, wrong[..., None], anywhere + translations[:, None], axis=1)
    return KeypointProblems(model_points, diameter, true, predicted)


def share_of_right_poses(problems: KeypointProblems, poses: np.ndarray) -> float:
    """Share of poses (B, 3, 4) that bring the keypoints near the true ones, 0 to 1."""
    found = problems.model_points @ poses[:, :, :3].transpose(0, 2, 1) + poses[:, None, :, 3]
    errors = np.linalg.norm(found - problems.true, axis=-1).mean(axis=1)
    return float((errors < _RIGHT * problems.diameter).mean())


def soft_ransac_poses(problems: KeypointProblems) -> np.ndarray:
    """Poses (B, 3, 4) by Soft RANSAC, all in one batch."""
    with torch.inference_mode():
        motion = solve(
            torch.from_numpy(problems.model_points).float(),
            torch.from_numpy(problems.predicted).float(),
            problems.diameter,
        )
    return torch.cat([motion.rotation, motion.translation[..., None]], dim=-1).numpy()


def affine_poses(problems: KeypointProblems) -> np.ndarray:
    """Poses (B, 3, 4) by OpenCV's robust affine fit, made rigid; NaN where it finds none."""
    poses = np.full((len(problems.predicted), 3, 4), np.nan)
    for pose, predicted in zip(poses, problems.predicted, strict=True):
        found, affine, _ = cv2.estimateAffine3D(
            problems.model_points, predicted, ransacThreshold=SOLVER_INLIER * problems.diameter
        )
        if not found or not np.isfinite(affine).all():
            continue
        u, _, vt = np.linalg.svd(affine[:, :3])
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        # A rotation about the keypoints' centroid, which stays where the affine map puts it.
        centroid = problems.model_points.mean(axis=0)
        pose[:, :3] = rotation
        pose[:, 3] = affine[:, :3] @ centroid + affine[:, 3] - rotation @ centroid
    return poses


def compare_speed(repeats: int, seed: int) -> dict[str, Any]:
    """Soft RANSAC of 32 poses against as many calls of ``cv2.solvePnPRansac``, for each pose.

    Returns:
        A record of the results file.
    """
    problems = draw_problems(np.random.default_rng(seed), _BATCH)
    pixels = project(problems.predicted, LINEMOD_K)

    def call_opencv() -> None:
        for seen in pixels:
            cv2.solvePnPRansac(problems.model_points, seen, LINEMOD_K, None)

    pairs = [
        (_seconds(lambda: soft_ransac_poses(problems)), _seconds(call_opencv))
        for _ in range(repeats + 2)
    ][2:]
    ours, theirs = (float(median) / _BATCH for median in np.median(pairs, axis=0))
    return {
        "metric": "ratio",
        "value": theirs / ours,
        "unit": "",
        "work": f"Soft RANSAC, a pose in a batch of {_BATCH}",
        "against": "cv2.solvePnPRansac, the same nine points",
        "goal": 1.0,
        "seconds": ours,
        "seconds_against": theirs,
        "n": repeats,
    }


def compare_robustness(seed: int, count: int = 500) -> dict[str, Any]:
    """Soft RANSAC against ``cv2.estimateAffine3D`` where 3 of 9 keypoints are gross outliers.

    Returns:
        A record of the results file: the ratio of the shares of right poses.
    """
    problems = draw_problems(np.random.default_rng(seed), count, outliers=_OUTLIERS)
    cv2.setRNGSeed(seed)
    ours = share_of_right_poses(problems, soft_ransac_poses(problems))
    theirs = share_of_right_poses(problems, affine_poses(problems))
    return {
        "metric": "ratio",
        "value": ours / max(theirs, 1 / count),
        "unit": "",
        "work": f"Soft RANSAC, right poses with {_OUTLIERS} of 9 keypoints wrong",
        "against": "cv2.estimateAffine3D",
        "goal": 1.0,
        "share": ours,
        "share_against": theirs,
        "n": count,
    }


def _seconds(work: Callable[[], Any]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
