"""Checks camera matrices, world poses, image sizes and ``camera.json``."""

from pathlib import Path

import numpy as np

from ..bop.fields import ROTATION_TOLERANCE, Place, read_json, read_numbers, rotation_errors
from ..bop.scene import Scene
from ..camera_mistakes import find_camera_mistake
from .findings import Finding, Findings


def check_cameras(scene: Scene, size: tuple[int, int] | None, findings: Findings) -> None:
    """Checks the cameras of a scene with images of ``size`` (H, W), None if unknown."""
    for image_id, K in zip(scene.image_id.tolist(), scene.K, strict=True):
        if not np.isnan(K).any() and (found := find_camera_mistake(K, size)) is not None:
            place = Place(scene.scene_id, image_id)
            findings.add(
                Finding(
                    found.severity, scene.camera_path, "cam_K",
                    found.problem, found.cause, found.remedy, place, found.detail,
                )
            )  # fmt: skip
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
