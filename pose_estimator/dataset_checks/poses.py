"""Can the poses be: rotations, distances, object numbers, objects that are annotated twice."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..bop.fields import ROTATION_TOLERANCE
from ..bop.scene import UNKNOWN, Scene
from .findings import Findings
from .meshes import CheckedModel

NEAREST, FARTHEST = 0.5, 1000.0
"""Distances from the camera, in diameters of the object, between which a translation can be."""

SAME_PLACE = 1e-3
"""Meters; two annotations of one object that are nearer are one."""


def check_poses(
    scene: Scene, models: Mapping[int, CheckedModel], findings: Findings
) -> tuple[np.ndarray, np.ndarray]:
    """Checks the annotations' numbers, without looking at images.

    Returns:
        Which rows of ``scene.annotations`` are whole, and which of them can be believed: bool (N,)
        each.
    """
    rows = scene.annotations
    T = rows.T_cam_obj
    whole = ~np.isnan(T).any(axis=(1, 2))
    whole &= ~_wrong_rotations(scene, whole, findings)
    modeled = np.isin(rows.obj_id, list(models))
    for row in np.flatnonzero((rows.obj_id != UNKNOWN) & ~modeled).tolist():
        if models:
            findings.error(
                scene.gt_path, "obj_id", "the object has no model",
                place=scene.place(row), detail=f"obj_id {rows.obj_id[row]}",
                cause="the models are another dataset's, or objects were numbered anew",
                remedy="add the model, or correct obj_id",
            )  # fmt: skip
    diameters = np.array(
        [models[i].measured if i in models else np.nan for i in rows.obj_id.tolist()]
    )
    believed = whole & ~_wrong_distances(scene, whole, diameters, findings)
    _check_twice(scene, whole, findings)
    return whole, believed


def _wrong_rotations(scene: Scene, whole: np.ndarray, findings: Findings) -> np.ndarray:
    """Which rows have a matrix that is no rotation; recorded data may be off by 5 percent."""
    rotations = np.where(whole[:, None, None], scene.annotations.T_cam_obj[:, :3, :3], np.eye(3))
    product = rotations @ rotations.swapaxes(1, 2)
    error = np.abs(product - np.eye(3)).max(axis=(1, 2))
    determinant = np.linalg.det(rotations)
    wrong = (error > ROTATION_TOLERANCE) | (determinant < 0)
    for row in np.flatnonzero(wrong).tolist():
        scale = np.abs(product[row] / max(product[row, 0, 0], 1e-12) - np.eye(3)).max()
        if determinant[row] < 0 and error[row] <= ROTATION_TOLERANCE:
            cause = "it mirrors: a left-handed frame, or an axis of the wrong sign"
        elif scale < ROTATION_TOLERANCE:
            cause = "a scale was multiplied into it"
        else:
            cause = "numbers are wrong, or of a quaternion or Euler angles"
        findings.error(
            scene.gt_path, "cam_R_m2c", "is not a rotation", cause=cause,
            place=scene.place(row),
            detail=f"determinant {determinant[row]:.3f}, off orthonormal by {error[row]:.2g}",
            remedy="give an orthonormal matrix of determinant +1, row by row",
        )  # fmt: skip
    return wrong


def _wrong_distances(
    scene: Scene, whole: np.ndarray, diameters: np.ndarray, findings: Findings
) -> np.ndarray:
    """Which rows put the object behind the camera, around it or out of sight."""
    rows = scene.annotations
    translation = rows.T_cam_obj[:, :3, 3]
    with np.errstate(invalid="ignore"):
        ratio = np.linalg.norm(translation, axis=1) / diameters
        near = whole & (ratio < NEAREST)
        far = whole & (ratio > FARTHEST)
        behind = whole & (translation[:, 2] <= 0) & ~near
    for row in np.flatnonzero(near | far).tolist():
        remedy = "give the object's origin in the camera's frame, in millimeters"
        meters = near[row] and NEAREST < 1000 * ratio[row] < FARTHEST
        where = f"{1e3 * np.linalg.norm(translation[row]):.4g} mm from the camera"
        size = f"an object of {1e3 * diameters[row]:.4g} mm"
        if meters:
            cause, remedy = "it is in meters; BOP has millimeters", "multiply cam_t_m2c by 1000"
        elif near[row]:
            cause = "the pose was never filled in, or maps camera to object"
        else:
            cause = "it was multiplied by 1000 once too often"
            remedy = "divide cam_t_m2c by 1000"
        findings.error(
            scene.gt_path, "cam_t_m2c",
            "the camera is inside of the object" if near[row] else "the object is too far away",
            place=scene.place(row), detail=f"{size}, {where}", cause=cause,
            remedy=remedy,
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


def _check_twice(scene: Scene, whole: np.ndarray, findings: Findings) -> None:
    """Two annotations of one object in one place."""
    rows = scene.annotations
    candidates = np.flatnonzero(whole)
    keys = np.column_stack(
        [
            rows.image_id[candidates],
            rows.obj_id[candidates],
            np.round(rows.T_cam_obj[candidates, :3, 3] / SAME_PLACE).astype(int),
        ]
    )
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    original = candidates[first[np.ravel(inverse)]]
    for row, other in zip(candidates.tolist(), original.tolist(), strict=True):
        if row != other:
            findings.error(
                scene.gt_path, "obj_id", "an object is annotated twice",
                place=scene.place(row),
                detail=f"object {rows.obj_id[row]} stands where annotation "
                f"{rows.index[other]} says",
                cause="annotations were joined", remedy="remove one of the two and its masks",
            )  # fmt: skip
