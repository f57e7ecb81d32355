"""Speed and robustness of Soft RANSAC compared with OpenCV and Open3D, for nine keypoints."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
import torch
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import LINEMOD_K, project
from two_view_pose.pose_estimator.solvers.rigid import SOLVER_INLIER, solve

from ..config import BenchConfig
from ..own_process import each_from_own_process
from ..stopwatch import Record, missing, ratio

_BATCH = 32
_OUTLIERS = 3
OPEN3D_HINT = (
    "pip install open3d (its wheel also asks for the system's libusb: apt-get install libusb-1.0-0)"
)

_MAX_ERROR = 0.1
"""Mean keypoint distance below which a pose is correct, diameters (as for ADD)."""


@dataclass(frozen=True, eq=False)
class KeypointProblems:
    """Poses to be found from keypoints.

    Attributes:
        model_points: (9, 3), object's frame, meters.
        diameter: meters.
        true: the keypoints in the camera's frame, (B, 9, 3), meters.
        predicted: what was found of them, (B, 9, 3), meters.
    """

    model_points: np.ndarray
    diameter: float
    true: np.ndarray
    predicted: np.ndarray


def draw_problems(
    rng: np.random.Generator, count: int, *, deviation: float = 0.005, outliers: int = 0
) -> KeypointProblems:
    """Draws poses about a meter away, of an object of LineMOD's size.

    Args:
        rng: where everything is drawn from.
        count: how many poses.
        deviation: standard deviation of the keypoints in meters, along each axis.
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


def share_of_correct_poses(problems: KeypointProblems, poses: np.ndarray) -> float:
    """Share of poses (B, 3, 4) that bring the keypoints near the true ones, 0 to 1."""
    found = problems.model_points @ poses[:, :, :3].transpose(0, 2, 1) + poses[:, None, :, 3]
    errors = np.linalg.norm(found - problems.true, axis=-1).mean(axis=1)
    return float((errors < _MAX_ERROR * problems.diameter).mean())


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


def measure(config: BenchConfig) -> Iterator[Record]:
    """Speed against three ways of OpenCV and one of Open3D, and robustness."""
    for against, theirs in (
        ("cv2.solvePnPRansac", _call_pnp),
        ("cv2.estimateAffine3D", _call_affine),
        ("cv2.estimateAffine3D, made rigid", affine_poses),
    ):
        yield from compare_speed(against, theirs, config.repeats, config.seed)
    # Open3D brings an OpenMP of its own.
    yield from each_from_own_process(compare_with_open3d, config.fewer_repeats, config.seed)
    yield compare_robustness(config.seed)


def compare_speed(
    against: str, theirs: Callable[[KeypointProblems], Any], repeats: int, seed: int
) -> Iterator[Record]:
    """Soft RANSAC of 32 poses against as many calls of another RANSAC, for each pose.

    Both get the same nine keypoints, once all good and once with three of them wrong: a RANSAC
    stops early where all agree, and Soft RANSAC always does the same work. The others stop when
    they would of themselves; those that need an inlier threshold get Soft RANSAC's.
    """
    for outliers in (0, _OUTLIERS):
        problems = draw_problems(np.random.default_rng(seed), _BATCH, outliers=outliers)
        cv2.setRNGSeed(seed)
        wrong = f", {outliers} of 9 keypoints wrong" if outliers else ""
        record = ratio(
            f"Soft RANSAC, a pose in a batch of {_BATCH}{wrong}",
            against,
            partial(soft_ransac_poses, problems),
            partial(theirs, problems),
            repeats,
            goal=1.0,
            share=_BATCH,
        )
        yield {**record, "outliers": outliers}


def compare_with_open3d(repeats: int, seed: int) -> Iterator[Record]:
    """The same against Open3D's RANSAC over correspondences."""
    try:
        import open3d
    except (ImportError, OSError) as error:  # OSError: a library of the system's is not there
        yield missing("Open3D", f"{type(error).__name__}: {error}", OPEN3D_HINT)
        return
    open3d.utility.random.seed(seed)
    vector, cloud = open3d.utility.Vector3dVector, open3d.geometry.PointCloud
    pairs = open3d.utility.Vector2iVector(np.tile(np.arange(9)[:, None], 2))
    register = open3d.pipelines.registration.registration_ransac_based_on_correspondence

    def call(problems: KeypointProblems) -> None:
        model = cloud(vector(problems.model_points))
        threshold = SOLVER_INLIER * problems.diameter
        for predicted in problems.predicted:
            register(model, cloud(vector(predicted)), pairs, threshold)

    yield from compare_speed("Open3D's RANSAC", call, repeats, seed)


def _call_pnp(problems: KeypointProblems) -> None:
    for seen in project(problems.predicted, LINEMOD_K):
        cv2.solvePnPRansac(problems.model_points, seen, LINEMOD_K, None)


def _call_affine(problems: KeypointProblems) -> None:
    threshold = SOLVER_INLIER * problems.diameter
    for predicted in problems.predicted:
        cv2.estimateAffine3D(problems.model_points, predicted, ransacThreshold=threshold)


def compare_robustness(seed: int, count: int = 500) -> Record:
    """Soft RANSAC against ``cv2.estimateAffine3D`` where 3 of 9 keypoints are gross outliers.

    Returns:
        A record of the results file: the ratio of the shares of right poses.
    """
    problems = draw_problems(np.random.default_rng(seed), count, outliers=_OUTLIERS)
    cv2.setRNGSeed(seed)
    ours = share_of_correct_poses(problems, soft_ransac_poses(problems))
    theirs = share_of_correct_poses(problems, affine_poses(problems))
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
