"""Triangulation by the direct linear transform, as OpenCV does it, with covariances.

Two views give four equations for a point, ``(u P3 - P1) X = 0`` and so on, of which OpenCV takes
the smallest singular vector (Hartley and Zisserman, *Multiple View Geometry*, section 12.2). To
first order that is least squares of the reprojection errors, weighted by the point's depths. With J
the derivative of the pixels by the point and D the depths,

    dX = (J^T D^2 J)^-1 J^T D^2 du,

which carries the covariances of the pixels to the point. A point that two views do not determine
(parallel rays, or an intersection behind a camera) is put where :mod:`triangulation` puts it, and
its covariance says how little is known.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from .reprojection import projection_jacobian
from .triangulation import MAX_DEPTH, MIN_DEPTH, PRIOR_STD, check_cameras, triangulate

_PRIOR_WEIGHT = 1e-9
"""Weight of what is known beforehand, relative to the pixels: it counts where they say nothing."""

_UNSEEN_VARIANCE = 1e8
"""Variance in pixels squared of a pixel that a view does not see."""


def triangulate_linearly(
    pixels: np.ndarray,
    covariances: np.ndarray,
    Ks: Sequence[np.ndarray],
    T_cam_world: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """The points that two views triangulate to; of more views, the mean over pairs.

    Each further view is paired with the first. The pairs' points are averaged by their covariances,
    and the covariance of the average knows that the pairs share the first view.

    Args:
        pixels: (V, N, 2), the same N points in V >= 2 views; NaN where a view does not see a point.
        covariances: of the pixels, (V, N, 2, 2), pixels squared.
        Ks: V camera matrices, (3, 3) each.
        T_cam_world: V transforms, (4, 4) each, meters. The world is any frame that they share.

    Returns:
        Points (N, 3) in the frame of the first camera, meters, and their covariances (N, 3, 3).
        Both are finite always.

    Raises:
        InputError: if shapes do not match, there are fewer than two views, or a camera is invalid.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    covariances = np.asarray(covariances, dtype=np.float64)
    cameras, T_view_first = check_cameras(pixels, covariances, Ks, T_cam_world)
    seen = np.isfinite(pixels).all(-1) & np.isfinite(covariances).all((-2, -1))
    nothing = _UNSEEN_VARIANCE * np.eye(2)
    covariances = np.where(seen[..., None, None], covariances, nothing)
    pairs = [[0, other] for other in range(1, len(pixels))]
    points = np.stack(
        [_pair(pixels[p], covariances[p], cameras[p], T_view_first[p]) for p in pairs]
    )
    gains, slack = zip(
        *(_gains(x, cameras[p], T_view_first[p]) for x, p in zip(points, pairs, strict=True)),
        strict=True,
    )
    shares = _shares(
        np.stack(
            [
                _carry(gain, covariances[p]) + rest
                for gain, rest, p in zip(gains, slack, pairs, strict=True)
            ]
        )
    )
    of_first = sum(share @ gain[0] for share, gain in zip(shares, gains, strict=True))
    of_others = [share @ gain[1] for share, gain in zip(shares, gains, strict=True)]
    covariance = _carry(np.stack([of_first, *of_others]), covariances)
    covariance += (shares @ np.stack(slack) @ shares.swapaxes(-1, -2)).sum(axis=0)
    return np.einsum("pnij,pnj->ni", shares, points), covariance


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


def _gains(
    points: np.ndarray, cameras: np.ndarray, T_view_first: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (2, N, 3, 2) of triangulated points (N, 3) by their pixels in both views.

    Returns:
        The derivatives, and the covariance (N, 3, 3) of what the pixels leave open.
    """
    seen = points @ T_view_first[:, :3, :3].swapaxes(-1, -2) + T_view_first[:, None, :3, 3]
    seen[..., 2] = np.maximum(seen[..., 2], MIN_DEPTH)
    J = projection_jacobian(seen, cameras) @ T_view_first[:, None, :3, :3]
    weight = seen[..., 2, None, None] ** 2
    normal = (weight * (J.swapaxes(-1, -2) @ J)).sum(axis=0)
    prior = _PRIOR_WEIGHT * np.trace(normal, axis1=-2, axis2=-1)[:, None, None] * np.eye(3)
    inverse = np.linalg.inv(normal + prior)
    open_part = PRIOR_STD * inverse @ prior
    return weight * (inverse @ J.swapaxes(-1, -2)), open_part @ open_part.swapaxes(-1, -2)


def _shares(covariances: np.ndarray) -> np.ndarray:
    """How much each of P estimates counts in their mean, (P, N, 3, 3), for their covariances.

    The shares of a point sum to the identity.
    """
    information = _inverse(covariances[:-1])
    shares = _inverse(information.sum(axis=0) + _inverse(covariances[-1])) @ information
    return np.concatenate([shares, np.eye(3) - shares.sum(axis=0, keepdims=True)])


def _inverse(matrices: np.ndarray) -> np.ndarray:
    """Inverse of positive semidefinite matrices, bounded where they are all but singular."""
    least = 1e-12 * np.trace(matrices, axis1=-2, axis2=-1)[..., None, None]
    return np.linalg.inv(matrices + least * np.eye(3))


def _carry(gains: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Sum over views of G S G^T, (N, 3, 3), for gains (V, N, 3, 2) and covariances (V, N, 2, 2)."""
    return (gains @ covariances @ gains.swapaxes(-1, -2)).sum(axis=0)
