"""From nine 3D keypoints to a pose: the solver of the paper, and the two it is measured against.

``soft`` is Soft RANSAC. ``kabsch`` is the least-squares fit of all nine keypoints. ``hard`` is
RANSAC (Fischler and Bolles 1981) without chance: all 84 triples are tried, the one that most
keypoints agree with wins, and its inliers are fitted by least squares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...core.errors import InputError
from ...core.geometry import make_transform
from .so3 import project_to_so3
from .soft_ransac import SoftRansacConfig, check_points, kabsch, soft_ransac
from .three_point import three_point_fits

SOLVERS = ("soft", "kabsch", "hard")
"""Names that :func:`solve` knows."""

SOLVER_INLIER = 0.2
"""Distance in diameters at which a keypoint counts half in Soft RANSAC, and no more in the hard."""

SOLVER_SHARPNESS = 4.0
"""How much Soft RANSAC leans towards its best hypotheses."""

_MIN_STD = 0.01
"""Standard deviation in diameters below which no keypoint is trusted more than another."""


class RigidMotions(NamedTuple):
    """Poses of B objects.

    Attributes:
        rotation: (B, 3, 3).
        translation: (B, 3), meters.
    """

    rotation: Tensor
    translation: Tensor


def check_solver(solver: str) -> str:
    """Returns the name of a solver.

    Raises:
        InputError: if it is none of ``SOLVERS``.
    """
    if solver not in SOLVERS:
        raise InputError(f"unknown solver {solver!r}; there are {', '.join(SOLVERS)}")
    return solver


def solve(
    model_points: Tensor,
    predicted: Tensor,
    diameter: float | Tensor,
    solver: str = "soft",
    covariance: Tensor | None = None,
) -> RigidMotions:
    """Poses from predicted keypoints.

    ``soft`` and ``kabsch`` are differentiable in ``predicted``. Of ``hard`` only the last fit is:
    which keypoints are inliers has no gradient.

    Args:
        model_points: keypoints in the object's frame, (K, 3) or (B, K, 3), meters.
        predicted: the same keypoints in the camera's frame, (B, K, 3), meters.
        diameter: of the object in meters, one number or one for each pose (B,).
        solver: one of ``SOLVERS``.
        covariance: of ``predicted``, (B, K, 3, 3); keypoints then count in inverse proportion to
            their variance. None lets all count the same.

    Raises:
        InputError: if the solver is unknown or shapes do not match.
    """
    check_solver(solver)
    weights = None if covariance is None else _weights(predicted, covariance, diameter)
    if solver == "kabsch":
        return RigidMotions(*kabsch(model_points, predicted, weights))
    if solver == "hard":
        return _hard_ransac(model_points, predicted, SOLVER_INLIER * diameter, weights)
    config = SoftRansacConfig.for_diameter(
        diameter, inlier=SOLVER_INLIER, sharpness=SOLVER_SHARPNESS
    )
    result = soft_ransac(model_points, predicted, config, weights)
    return RigidMotions(result.rotation, result.translation)


@torch.no_grad()
def solve_pose(
    model_points: np.ndarray,
    predicted: np.ndarray,
    diameter: float,
    solver: str = "soft",
    covariance: np.ndarray | None = None,
) -> np.ndarray:
    """T_cam_obj (4, 4) of one object: :func:`solve` for arrays (9, 3) and (9, 3, 3)."""
    motion = solve(
        _on_cpu(model_points),
        _on_cpu(predicted)[None],
        _on_cpu(np.array([diameter])),
        solver,
        None if covariance is None else _on_cpu(covariance)[None],
    )
    # Single precision's rounding is removed from the rotation.
    u, _, vt = np.linalg.svd(motion.rotation[0].double().cpu().numpy())
    return make_transform(u @ vt, motion.translation[0].double().cpu().numpy())


def _on_cpu(array: np.ndarray) -> Tensor:
    """One pose is too small to be worth a way to a GPU."""
    return torch.from_numpy(array).to("cpu", torch.float32)


def _weights(predicted: Tensor, covariance: Tensor, diameter: float | Tensor) -> Tensor:
    """How much each keypoint counts, (B, K), one on average."""
    if covariance.shape != (*predicted.shape, 3):
        raise InputError(
            f"covariance must be {(*predicted.shape, 3)} to match predicted, "
            f"got shape {tuple(covariance.shape)}"
        )
    variance = covariance.detach().diagonal(dim1=-2, dim2=-1).mean(dim=-1)
    floor = torch.as_tensor(_MIN_STD * diameter, dtype=variance.dtype, device=variance.device)
    weights = 1 / (variance.clamp_min(0) + floor.square().reshape(-1, 1))
    return weights / weights.mean(dim=-1, keepdim=True)


def _hard_ransac(
    model_points: Tensor, predicted: Tensor, threshold: float | Tensor, weights: Tensor | None
) -> RigidMotions:
    """The least-squares fit of the largest set of keypoints that agree with one triple."""
    model_points, predicted = check_points(model_points, predicted)
    with torch.autocast(predicted.device.type, enabled=False):
        hypotheses = three_point_fits(model_points, predicted)
        with torch.no_grad():
            distances = hypotheses.residuals()
            limit = torch.as_tensor(threshold, dtype=distances.dtype, device=distances.device)
            limit = limit.reshape(-1, 1, 1)
            inliers = distances < limit
            # Of two triples with as many inliers, the better fit: its share is less than one.
            misfit = torch.minimum(distances / limit, distances.new_ones(())).square().mean(dim=1)
            worst = 1e4 * hypotheses.degenerate
            best = (inliers.sum(dim=1) - misfit - worst).argmax(dim=-1)
            chosen = torch.nn.functional.one_hot(best, distances.shape[-1]).to(predicted.dtype)
        agreeing = (inliers & chosen[:, None].bool()).any(dim=-1).to(predicted.dtype)
        fitted = kabsch(
            model_points, predicted, agreeing if weights is None else agreeing * weights
        )
        enough = agreeing.sum(dim=-1) >= 3
        rotation, place = hypotheses.average(chosen)
        rotation = project_to_so3(rotation)
        center = hypotheses.triangles.center[..., None]
        triple = rotation, place - (rotation @ center)[..., 0]
        return RigidMotions(
            torch.where(enough[:, None, None], fitted[0], triple[0]),
            torch.where(enough[:, None], fitted[1], triple[1]),
        )
