"""ADD-S compared with the BOP toolkit, which builds a tree of the estimate's points per pose."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from two_view_pose import assets
from two_view_pose.core.geometry import make_transform, transform
from two_view_pose.pose_estimator.evaluation import metrics
from two_view_pose.pose_estimator.evaluation.nearest_points import NearestPoints

from ..config import BenchConfig
from ..stopwatch import Record, ratio

POINTS = 5000
_POSES = 8
"""Pairs of poses of each object."""

PosePair = tuple[np.ndarray, np.ndarray]


def add_s_of_bop(T_est: np.ndarray, T_true: np.ndarray, points: np.ndarray) -> float:
    """ADD-S in meters as ``bop_toolkit_lib.pose_error.adi`` computes it."""
    tree = cKDTree(transform(T_est, points))
    distances, _ = tree.query(transform(T_true, points), k=1)
    return float(distances.mean())


def pose_pairs(rng: np.random.Generator, diameter: float, count: int) -> list[PosePair]:
    """Estimated and true poses, from nearly correct to clearly wrong.

    Args:
        rng: where they are drawn from.
        diameter: of the object, meters.
        count: how many; their errors grow evenly in their logarithm, from 1 to 60 degrees with
            0.01 to 0.5 diameters.

    Returns:
        T_est and T_true, (4, 4) each.
    """
    pairs = []
    for share in np.linspace(0.0, 1.0, count):
        angle, distance = np.deg2rad(1.0) * 60**share, 0.01 * diameter * 50**share
        axis, direction = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        true = make_transform(
            Rotation.random(rng=rng).as_matrix(), rng.uniform((-0.1, -0.1, 0.7), (0.1, 0.1, 1.2))
        )
        wrong = make_transform(Rotation.from_rotvec(angle * axis).as_matrix(), np.zeros(3))
        estimated = true @ wrong
        estimated[:3, 3] += distance * direction
        pairs.append((estimated, true))
    return pairs


def measure(config: BenchConfig, count: int = POINTS) -> Iterator[Record]:
    """ADD-S of our symmetric objects, with the index of each kept, against the BOP toolkit's way.

    Args:
        config: its repeats, and the seed of the points and the poses.
        count: points on each surface, sampled for each run.

    Yields:
        A record of the results file, seconds for one pose; ``largest_difference`` is in meters.
    """
    rng = np.random.default_rng(config.seed)
    cases = []
    for model in assets.load_objects(None).values():
        if not model.symmetric:
            continue
        mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
        points = np.asarray(trimesh.sample.sample_surface(mesh, count, seed=config.seed)[0])
        index = NearestPoints(points)
        cases += [(*pair, points, index) for pair in pose_pairs(rng, model.diameter, _POSES)]

    def ours() -> list[float]:
        return [metrics.add_s(est, true, points, tree=index) for est, true, points, index in cases]

    def theirs() -> list[float]:
        return [add_s_of_bop(est, true, points) for est, true, points, _ in cases]

    record = ratio(
        f"ADD-S of {count} points",
        "the BOP toolkit's way: a cKDTree for every estimate",
        ours,
        theirs,
        config.repeats,
        goal=3.0,
        share=len(cases),
    )
    difference = np.abs(np.subtract(ours(), theirs())).max()
    yield {**record, "largest_difference": float(difference)}
