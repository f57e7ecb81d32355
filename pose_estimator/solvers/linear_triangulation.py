"""Triangulation by the direct linear transform (OpenCV), with covariances.

Two views give four equations for a point, ``(u P3 - P1) X = 0`` and so on, of which OpenCV takes
the smallest singular vector (Hartley and Zisserman, *Multiple View Geometry*, section 12.2). To
first order that is least squares of the reprojection errors, weighted by the point's depths. With J
the derivative of the pixels in the point and D the depths,

    dX = (J^T D^2 J)^-1 J^T D^2 du,

which propagates the pixels' covariances to the point. A point that two views do not determine
(parallel rays, or an intersection behind a camera) is taken from :mod:`triangulation`, with a large
covariance.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from ...core.errors import InputError
from .reprojection import check_cameras, projection_jacobian
from .triangulation import MAX_DEPTH, MIN_DEPTH, PRIOR_STD, triangulate

_PRIOR_WEIGHT = 1e-9
"""Weight of the prior relative to the pixels: it matters only in unobservable directions."""

_UNSEEN_VARIANCE = 1e8
"""Variance in pixels squared of a point that a view does not see."""


def triangulate_linearly(
    pixels: np.ndarray,
    covariances: np.ndarray,
    Ks: Sequence[np.ndarray],
    T_cam_world: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Triangulates points from two views; from more views, averages the pairs.

    Each further view is paired with the first. The pairs' points are averaged by their covariances,
    and the covariance of the average accounts for the shared first view.

    Takes, returns and raises what :func:`triangulation.triangulate` does.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    covariances = np.asarray(covariances, dtype=np.float64)
    cameras, T_view_first = check_cameras(pixels, covariances, Ks, T_cam_world)
    if len(pixels) < 2:
        raise InputError(f"triangulation needs V >= 2 views, got {len(pixels)}")
    seen = np.isfinite(pixels).all(-1) & np.isfinite(covariances).all((-2, -1))
    covariances = np.where(seen[..., None, None], covariances, _UNSEEN_VARIANCE * np.eye(2))
    points, jacobians, priors, totals = [], [], [], []
    for other in range(1, len(pixels)):
        p = [0, other]
        points.append(_pair(pixels[p], covariances[p], cameras[p], T_view_first[p]))
        jacobian, prior = _jacobians(points[-1], cameras[p], T_view_first[p])
        jacobians.append(jacobian)
        priors.append(prior)
        totals.append(_propagate_covariance(jacobian, covariances[p]) + prior)
    weights = _fusion_weights(np.stack(totals))
    of_first = sum(w @ jacobian[0] for w, jacobian in zip(weights, jacobians, strict=True))
    of_others = [w @ jacobian[1] for w, jacobian in zip(weights, jacobians, strict=True)]
    covariance = _propagate_covariance(np.stack([of_first, *of_others]), covariances)
    covariance += (weights @ np.stack(priors) @ weights.swapaxes(-1, -2)).sum(axis=0)
    return np.einsum("pnij,pnj->ni", weights, np.stack(points)), covariance


def _pair(
    pixels: np.ndarray, covariances: np.ndarray, cameras: np.ndarray, T_view_first: np.ndarray
) -> np.ndarray:
    """Triangulates N points from two views, (N, 3)."""
    projections = cameras @ T_view_first[:, :3]
    homogeneous = cv2.triangulatePoints(
        *projections, *(np.ascontiguousarray(np.nan_to_num(p).T) for p in pixels)
    )
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        points = (homogeneous[:3] / homogeneous[3]).T
        depths = points @ T_view_first[:, 2, :3].T + T_view_first[:, 2, 3]  # (N, 2)
        sound = np.isfinite(points).all(1) & np.isfinite(pixels).all((0, 2))
        sound &= ((depths > MIN_DEPTH) & (depths < MAX_DEPTH)).all(1)
    if not sound.all():
        points[~sound] = triangulate(
            pixels[:, ~sound], covariances[:, ~sound], list(cameras), list(T_view_first)
        )[0]
    return points


def _jacobians(
    points: np.ndarray, cameras: np.ndarray, T_view_first: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (2, N, 3, 2) of triangulated points (N, 3) in their pixels in both views.

    Also returns the covariance (N, 3, 3) of unobservable directions, which the prior bounds.
    """
    seen = points @ T_view_first[:, :3, :3].swapaxes(-1, -2) + T_view_first[:, None, :3, 3]
    seen[..., 2] = np.maximum(seen[..., 2], MIN_DEPTH)
    J = projection_jacobian(seen, cameras) @ T_view_first[:, None, :3, :3]
    weight = seen[..., 2, None, None] ** 2
    normal = (weight * (J.swapaxes(-1, -2) @ J)).sum(axis=0)
    prior = _PRIOR_WEIGHT * np.trace(normal, axis1=-2, axis2=-1)[:, None, None] * np.eye(3)
    inverse = np.linalg.inv(normal + prior)
    unobservable = PRIOR_STD * inverse @ prior
    return weight * (inverse @ J.swapaxes(-1, -2)), unobservable @ unobservable.swapaxes(-1, -2)


def _fusion_weights(covariances: np.ndarray) -> np.ndarray:
    """Information weights (P, N, 3, 3) of P estimates in their mean; they sum to the identity."""
    information = _inverse(covariances[:-1])
    weights = _inverse(information.sum(axis=0) + _inverse(covariances[-1])) @ information
    return np.concatenate([weights, np.eye(3) - weights.sum(axis=0, keepdims=True)])


def _inverse(matrices: np.ndarray) -> np.ndarray:
    """Inverse of positive semidefinite matrices, regularized where they are nearly singular."""
    ridge = 1e-12 * np.trace(matrices, axis1=-2, axis2=-1)[..., None, None]
    return np.linalg.inv(matrices + ridge * np.eye(3))


def _propagate_covariance(jacobians: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Sum of J S J^T over views, (N, 3, 3), for J (V, N, 3, 2) and S (V, N, 2, 2)."""
    return (jacobians @ covariances @ jacobians.swapaxes(-1, -2)).sum(axis=0)
