"""ADD-S beside the way of the BOP toolkit: a tree of the estimate's points for every pose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..assets.object_model import ObjectModel
from . import metrics
from .geometry import make_transform, transform
from .nearest_points import NearestPoints
from .stopwatch import ratio

POINTS = 5000
_POSES = 8
"""Pairs of poses of each object."""

PosePair = tuple[np.ndarray, np.ndarray]


def add_s_of_bop(T_est: np.ndarray, T_true: np.ndarray, points: np.ndarray) -> float:
    """ADD-S in metres as ``bop_toolkit_lib.pose_error.adi`` computes it."""
    tree = cKDTree(transform(T_est, points))
    distances, _ = tree.query(transform(T_true, points), k=1)
    return float(distances.mean())


def pose_pairs(rng: np.random.Generator, diameter: float, count: int) -> list[PosePair]:
    """Estimated and true poses, from nearly right to plainly wrong.

    Args:
        rng: where they are drawn from.
        diameter: of the object, metres.
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


def compare_add_s(
    objects: Mapping[str, ObjectModel], repeats: int, seed: int, count: int = POINTS
) -> dict[str, Any]:
    """ADD-S of symmetric objects, with the index of each kept, against the BOP toolkit's way.

    Args:
        objects: their surfaces are sampled anew.
        repeats: timed repeats of each side.
        seed: of the points and the poses.
        count: points on each surface.

    Returns:
        A record of the results file, seconds for one pose; ``largest_difference`` is in metres.
    """
    rng = np.random.default_rng(seed)
    cases = []
    for model in objects.values():
        mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
        points = np.asarray(trimesh.sample.sample_surface(mesh, count, seed=seed)[0])
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
        repeats,
        goal=3.0,
        share=len(cases),
    )
    difference = np.abs(np.subtract(ours(), theirs())).max()
    return {**record, "largest_difference": float(difference)}
