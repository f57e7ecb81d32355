"""Checks poses: rotations, distances, object ids, duplicated annotations."""

from collections.abc import Mapping

import numpy as np

from ..bop.fields import ROTATION_TOLERANCE, rotation_errors
from ..bop.scene import UNKNOWN, Scene
from .findings import Findings
from .meshes import CheckedModel

MIN_DISTANCE, MAX_DISTANCE = 0.5, 1000.0
"""Range of plausible distances from the camera, in diameters of the object."""

DUPLICATE_METERS = 1e-3
"""Annotations of one object that are nearer to each other are duplicates."""


def check_poses(
    scene: Scene, models: Mapping[int, CheckedModel], findings: Findings
) -> tuple[np.ndarray, np.ndarray]:
    """Checks the annotations' numbers, without images.

    Returns:
        Rows of ``scene.annotations`` with a valid pose, and with a plausible one: bool (N,) each.
    """
    rows = scene.annotations
    T = rows.T_cam_obj
    valid = ~np.isnan(T).any(axis=(1, 2))
    valid &= ~_wrong_rotations(scene, valid, findings)
    modeled = np.isin(rows.obj_id, list(models))
    for row in np.flatnonzero((rows.obj_id != UNKNOWN) & ~modeled).tolist():
        if models:
            findings.error(
                scene.gt_path, "obj_id", "the object has no model",
                place=scene.place(row), detail=f"obj_id {rows.obj_id[row]}",
                cause="the models are another dataset's, or objects were renumbered",
                remedy="add the model, or correct obj_id",
            )  # fmt: skip
    diameters = np.array(
        [models[i].measured if i in models else np.nan for i in rows.obj_id.tolist()]
    )
    plausible = valid & ~_wrong_distances(scene, valid, diameters, findings)
    _check_twice(scene, valid, findings)
    return valid, plausible


def _wrong_rotations(scene: Scene, valid: np.ndarray, findings: Findings) -> np.ndarray:
    """Returns which rows have a matrix that is not a rotation within tolerance."""
    rotations = np.where(valid[:, None, None], scene.annotations.T_cam_obj[:, :3, :3], np.eye(3))
    wrong = rotation_errors(rotations) > ROTATION_TOLERANCE
    for row in np.flatnonzero(wrong).tolist():
        product, determinant = rotations[row] @ rotations[row].T, np.linalg.det(rotations[row])
        error = np.abs(product - np.eye(3)).max()
        scale = np.abs(product / max(product[0, 0], 1e-12) - np.eye(3)).max()
        if determinant < 0 and error <= ROTATION_TOLERANCE:
            cause = "it is a reflection: a left-handed frame, or an axis of the wrong sign"
        elif scale < ROTATION_TOLERANCE:
            cause = "a scale was multiplied into it"
        else:
            cause = "numbers are wrong, or are a quaternion or Euler angles"
        findings.error(
            scene.gt_path, "cam_R_m2c", "is not a rotation", cause=cause,
            place=scene.place(row),
            detail=f"determinant {determinant:.3f}, off orthonormal by {error:.2g}",
            remedy="write an orthonormal matrix of determinant +1, row-major",
        )  # fmt: skip
    return wrong


def _wrong_distances(
    scene: Scene, valid: np.ndarray, diameters: np.ndarray, findings: Findings
) -> np.ndarray:
    """Returns which rows place the object behind the camera, around it or too far away."""
    rows = scene.annotations
    translation = rows.T_cam_obj[:, :3, 3]
    with np.errstate(invalid="ignore"):
        ratio = np.linalg.norm(translation, axis=1) / diameters
        near = valid & (ratio < MIN_DISTANCE)
        far = valid & (ratio > MAX_DISTANCE)
        behind = valid & (translation[:, 2] <= 0) & ~near
    for row in np.flatnonzero(near | far).tolist():
        remedy = "write the object's origin in the camera frame, in millimeters"
        where = f"{1e3 * np.linalg.norm(translation[row]):.4g} mm from the camera"
        size = f"an object of {1e3 * diameters[row]:.4g} mm"
        if near[row] and MIN_DISTANCE < 1000 * ratio[row] < MAX_DISTANCE:
            cause, remedy = "it is in meters; BOP has millimeters", "multiply cam_t_m2c by 1000"
        elif near[row]:
            cause = "the pose was never filled in, or maps camera to object"
        else:
            cause, remedy = "it was scaled by 1000 twice", "divide cam_t_m2c by 1000"
        findings.error(
            scene.gt_path, "cam_t_m2c",
            "the camera is inside the object" if near[row] else "the object is too far away",
            place=scene.place(row), detail=f"{size}, {where}",
            cause=cause, remedy=remedy,
        )  # fmt: skip
    for row in np.flatnonzero(behind).tolist():
        findings.error(
            scene.gt_path, "cam_t_m2c", "the object is behind the camera",
            place=scene.place(row),
            detail=f"z = {1e3 * translation[row, 2]:.4g} mm",
            cause="the camera's axes are OpenGL's (y up, z backward), or the pose is inverted",
            remedy="multiply poses by diag(1, -1, -1, 1) from the left: OpenCV has z forward",
        )  # fmt: skip
    return near | far | behind


def _check_twice(scene: Scene, valid: np.ndarray, findings: Findings) -> None:
    """Reports several annotations of one object in one place."""
    rows = scene.annotations
    candidates = np.flatnonzero(valid)
    keys = np.column_stack(
        [
            rows.image_id[candidates],
            rows.obj_id[candidates],
            np.round(rows.T_cam_obj[candidates, :3, 3] / DUPLICATE_METERS).astype(int),
        ]
    )
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    original = candidates[first[np.ravel(inverse)]]
    for row, other in zip(candidates.tolist(), original.tolist(), strict=True):
        if row != other:
            findings.error(
                scene.gt_path, "obj_id", "the object is annotated twice", place=scene.place(row),
                detail=f"object {rows.obj_id[row]} has the pose of annotation {rows.index[other]}",
                cause="annotations were merged", remedy="remove one of the two and its masks",
            )  # fmt: skip
