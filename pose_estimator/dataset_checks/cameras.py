"""Checks camera matrices, world poses, image sizes and ``camera.json``."""

from pathlib import Path

import numpy as np

from ...core.geometry import check_intrinsics
from ..bop.fields import ROTATION_TOLERANCE, Place, read_json, read_numbers, rotation_errors
from ..bop.pose_mistakes import WRITE_K
from ..bop.scene import Scene
from .findings import Finding, Findings, Severity

MIDDLE = (0.25, 0.75)
"""Range of a plausible principal point, as fractions of the image's sides."""


def check_cameras(scene: Scene, size: tuple[int, int] | None, findings: Findings) -> None:
    """Checks the cameras of a scene with images of ``size`` (H, W), None if unknown."""
    for image_id, K in zip(scene.image_id.tolist(), scene.K, strict=True):
        if not np.isnan(K).any() and (found := _check_matrix(K, size)) is not None:
            severity, problem, cause, remedy, detail = found
            place = Place(scene.scene_id, image_id)
            findings.add(
                Finding(severity, scene.camera_path, "cam_K", problem, cause, remedy, place, detail)
            )
    for i in np.flatnonzero(~rigid_or_nan(scene.T_cam_world)).tolist():
        findings.error(
            scene.camera_path, "cam_R_w2c", "is not a rotation",
            place=Place(scene.scene_id, int(scene.image_id[i])),
            remedy="write an orthonormal matrix of determinant +1, row-major",
        )  # fmt: skip
    for i in np.flatnonzero(scene.depth_scale <= 0).tolist():
        findings.error(
            scene.camera_path, "depth_scale", "must be positive",
            place=Place(scene.scene_id, int(scene.image_id[i])),
            detail=f"{scene.depth_scale[i]:g}",
            remedy="write the millimeters per unit of the depth map",
        )  # fmt: skip


def rigid_or_nan(T: np.ndarray) -> np.ndarray:
    """Returns which transforms (N, 4, 4) are rigid within tolerance, or NaN: bool (N,)."""
    known = ~np.isnan(T).any(axis=(1, 2))
    T = np.where(known[:, None, None], T, np.eye(4))
    affine = np.abs(T[:, 3] - (0, 0, 0, 1)).max(axis=1) < 1e-3
    return (rotation_errors(T[:, :3, :3]) <= ROTATION_TOLERANCE) & affine


def _check_matrix(
    K: np.ndarray, size: tuple[int, int] | None
) -> tuple[Severity, str, str, str, str] | None:
    """Returns severity, problem, cause, remedy and detail of an invalid camera matrix, or None."""
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    try:
        check_intrinsics(K)
    except ValueError:
        transposed = np.allclose(K[:2, 2], 0) and (K[2, :2] > 0).all()
        cause = "it is transposed: MATLAB is column-major" if transposed else ""
        return "error", "is not a valid camera matrix", cause, WRITE_K, f"{K.round(2).tolist()}"
    if size is None:
        return None
    height, width = size
    pixels = f"fx {fx:.6g}, fy {fy:.6g}, cx {cx:.6g}, cy {cy:.6g} for images of {width}x{height}"
    share = np.array([cx / width, cy / height])
    if (share < 0).any() or (share > 1 - 1e-9).any():
        problem = "the principal point is outside the image"
        return "error", problem, *_explain(K, size), pixels
    if max(fx, fy) < 0.1 * width:
        remedy = "write focal lengths in pixels"
        cause = "they are in millimeters or fractions of the image's width"
        return "error", "the focal lengths are too short", cause, remedy, pixels
    if not 0.8 < fx / fy < 1.25:
        cause = "the image was stretched, or the numbers are in another order"
        return "warning", "fx and fy differ by more than 25 %", cause, WRITE_K, pixels
    if (share < MIDDLE[0]).any() or (share > MIDDLE[1]).any():
        problem = "the principal point is far from the image center"
        return "warning", problem, *_explain(K, size), pixels
    return None


def _explain(K: np.ndarray, size: tuple[int, int]) -> tuple[str, str]:
    """Returns the probable cause of an implausible principal point, and the remedy."""
    (fx, _, cx), (_, fy, cy) = K[:2] / np.array([[size[1]], [size[0]]])
    if max(abs(fx - 0.5), abs(fy - 0.5)) < 0.15 and abs(K[0, 2] / K[1, 2] - 1) < 0.1:
        return "focal lengths and principal point are swapped", WRITE_K
    scale = cx + cy
    if min(cx, cy) > 0 and abs(cx / cy - 1) < 0.3 and not 0.7 < scale < 1.4:
        return (
            f"it is the matrix of images {scale:.2g} times as large",
            f"divide fx, fy, cx and cy by {scale:.2g}, or use images of the calibrated size",
        )
    return (
        "another camera's matrix, numbers in another order, or cropped images",
        "calibrate again; after a crop subtract its corner from cx and cy",
    )


def read_camera_size(root: Path, findings: Findings) -> tuple[int, int] | None:
    """Returns height and width of ``camera.json``; None where it is missing or invalid."""
    path = root / "camera.json"
    content = read_json(path, dict, findings.error) if path.is_file() else None
    if content is None:
        return None
    names = ("height", "width", "fx", "fy", "cx", "cy")
    values = [read_numbers([content], n, 1, path, [Place()], findings.error)[0, 0] for n in names]
    if np.isnan(values[:2]).any():
        return None
    return int(values[0]), int(values[1])
