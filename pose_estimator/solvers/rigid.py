"""Pose from nine 3D keypoints: the solver of the paper and its baselines.

``soft`` is Soft RANSAC with sharpened weights, ``soft-mean`` with the paper's. ``kabsch`` is the
least-squares fit of all nine keypoints. ``hard`` is exhaustive (deterministic) RANSAC (Fischler and
Bolles 1981): of all 84 triples the one with most inliers is chosen, and its inliers are fitted by
least squares.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...core.errors import InputError
from ...core.geometry import make_transform
from ..methods import SOLVERS
from .so3 import project_to_so3
from .soft_ransac import SoftRansacConfig, check_points, kabsch, soft_ransac
from .three_point import three_point_fits

SOLVER_INLIER = 0.2
"""Inlier threshold in diameters; in Soft RANSAC a keypoint at this distance counts half."""

SOLVER_SHARPNESS = {"soft": 4.0, "soft-mean": 1.0}
"""Exponents of Soft RANSAC's scores; the paper's is 1."""


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
) -> RigidMotions:
    """Computes poses from predicted keypoints.

    ``soft`` and ``kabsch`` are differentiable in ``predicted``, of ``hard`` only the last fit.

    Args:
        model_points: keypoints in the object's frame, (K, 3) or (B, K, 3), meters.
        predicted: the same keypoints in the camera's frame, (B, K, 3), meters.
        diameter: of the object in meters, one number or one for each pose (B,).
        solver: one of ``SOLVERS``.

    Raises:
        InputError: if the solver is unknown or shapes do not match.
    """
    check_solver(solver)
    if solver == "kabsch":
        return RigidMotions(*kabsch(model_points, predicted))
    if solver == "hard":
        return _hard_ransac(model_points, predicted, SOLVER_INLIER * diameter)
    config = SoftRansacConfig.for_diameter(
        diameter, inlier=SOLVER_INLIER, sharpness=SOLVER_SHARPNESS[solver]
    )
    result = soft_ransac(model_points, predicted, config)
    return RigidMotions(result.rotation, result.translation)


@torch.no_grad()
def solve_pose(
    model_points: np.ndarray, predicted: np.ndarray, diameter: float, solver: str = "soft"
) -> np.ndarray:
    """T_cam_obj (4, 4) of one object: :func:`solve` for keypoints (9, 3)."""
    motion = solve(
        _on_cpu(model_points), _on_cpu(predicted)[None], _on_cpu(np.array([diameter])), solver
    )
    # Removes single precision's rounding from the rotation.
    u, _, vt = np.linalg.svd(motion.rotation[0].double().cpu().numpy())
    return make_transform(u @ vt, motion.translation[0].double().cpu().numpy())


def _on_cpu(array: np.ndarray) -> Tensor:
    """A single pose is too small to benefit from a GPU."""
    return torch.from_numpy(array).to("cpu", torch.float32)


def _hard_ransac(
    model_points: Tensor, predicted: Tensor, threshold: float | Tensor
) -> RigidMotions:
    """Fits the largest set of inliers of one triple by least squares."""
    model_points, predicted = check_points(model_points, predicted)
    with torch.autocast(predicted.device.type, enabled=False):
        hypotheses = three_point_fits(model_points, predicted)
        with torch.no_grad():
            distances = hypotheses.residuals()
            limit = torch.as_tensor(threshold, dtype=distances.dtype, device=distances.device)
            limit = limit.reshape(-1, 1, 1)
            inliers = distances < limit
            # Breaks ties between equal numbers of inliers; less than one.
            misfit = torch.minimum(distances / limit, distances.new_ones(())).square().mean(dim=1)
            penalty = 1e4 * hypotheses.degenerate
            best = (inliers.sum(dim=1) - misfit - penalty).argmax(dim=-1)
            chosen = torch.nn.functional.one_hot(best, distances.shape[-1]).to(predicted.dtype)
        consensus = (inliers & chosen[:, None].bool()).any(dim=-1).to(predicted.dtype)
        fitted = kabsch(model_points, predicted, consensus)
        enough = consensus.sum(dim=-1) >= 3
        rotation, position = hypotheses.average(chosen)
        rotation = project_to_so3(rotation)
        center = hypotheses.triangles.center[..., None]
        triple = rotation, position - (rotation @ center)[..., 0]
        return RigidMotions(
            torch.where(enough[:, None, None], fitted[0], triple[0]),
            torch.where(enough[:, None], fitted[1], triple[1]),
        )
