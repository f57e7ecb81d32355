"""Checks that view pairs and camera world poses agree with the poses of static objects."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ...core.geometry import invert
from ..bop.fields import Place
from ..bop.pairs import BopPair
from ..bop.scene import Scene
from ..camera_mistakes import OPENGL, scaled
from .cameras import rigid_or_nan
from .findings import Findings
from .meshes import CheckedModel

STILL = 0.02
"""Tolerance in meters of a static object's position, in addition to a tenth of its diameter."""

Reading = tuple[str, str, Callable[[np.ndarray], np.ndarray]]


_READINGS: tuple[Reading, ...] = (
    ("it is inverted", "invert it", invert),
    ("it is in meters; BOP has millimeters", "multiply translations by 1000", scaled(1e3)),
    ("it was scaled by 1000 twice", "divide translations by 1000", scaled(1e-3)),
    (
        "it is inverted, and in meters", "invert it, and multiply translations by 1000",
        lambda T: invert(scaled(1e3)(T)),
    ),
)  # fmt: skip

_PAIR_READINGS: tuple[Reading, ...] = (
    *_READINGS,
    (
        "it is between OpenGL cameras (y up, z backward)",
        "multiply it by diag(1, -1, -1, 1) from both sides", lambda T: OPENGL @ T @ OPENGL,
    ),
)  # fmt: skip

_WORLD_READINGS: tuple[Reading, ...] = (
    *_READINGS,
    (
        "its camera is OpenGL's (y up, z backward)",
        "multiply it by diag(1, -1, -1, 1) from the left", lambda T: OPENGL @ T,
    ),
    (
        "it is the pose of an OpenGL camera in the world",
        "invert it, then multiply it by diag(1, -1, -1, 1) from the left",
        lambda T: OPENGL @ invert(T),
    ),
)  # fmt: skip


def check_pairs(
    path: Path,
    pairs: Mapping[int, BopPair],
    scene: Scene,
    models: Mapping[int, CheckedModel],
    reliable: np.ndarray,
    findings: Findings,
) -> None:
    """Checks the pairs of one scene against the poses of their objects.

    Args:
        path: the file of pairs.
        pairs: position in the file -> pair of the scene.
        scene: the scene.
        models: obj_id -> model.
        reliable: bool (N,), annotations with a plausible pose.
        findings: receives the findings.
    """
    poses = _poses(scene, reliable)
    images = set(scene.image_id.tolist())
    for number, pair in pairs.items():
        first, second = pair.ref_image_id, pair.second_image_id
        place = Place(scene.scene_id, first)
        where = f"pair {number}, images {first} and {second}"
        if lost := [i for i in (first, second) if i not in images]:
            findings.error(
                path, "image", "the pair's image does not exist", place=place,
                detail=f"{where}: scene {pair.scene_id} has no image {lost[0]}",
                remedy="remove the pair, or restore the image",
            )  # fmt: skip
            continue
        T = pair.T_second_ref
        if np.isnan(T).any():
            continue
        if not rigid_or_nan(T[None])[0]:
            findings.error(
                path, "T_second_ref", "is not a rigid motion", place=place,
                detail=f"{where}: determinant {np.linalg.det(T[:3, :3]):.3f}",
                remedy="give a rotation and a translation in millimeters",
            )  # fmt: skip
            continue
        shown = [
            (poses[first, o], poses[second, o], o)
            for o in pair.obj_ids
            if (first, o) in poses and (second, o) in poses
        ]
        if not shown or (distance := _median_distance(T, shown, models)) <= 1:
            continue
        explained = (r for r in _PAIR_READINGS if _median_distance(r[2](T), shown, models) <= 1)
        unknown = "it is another pair's, or the objects moved", "compute it again"
        cause, remedy, *_ = next(explained, unknown)
        findings.error(
            path, "T_second_ref", "the pair disagrees with the poses of its objects", place=place,
            detail=f"{where}: objects are off by {1e3 * STILL * distance:.0f} mm or more",
            cause=cause, remedy=remedy,
        )  # fmt: skip


def _median_distance(
    T: np.ndarray,
    shown: Sequence[tuple[np.ndarray, np.ndarray, int]],
    models: Mapping[int, CheckedModel],
) -> float:
    """Returns the objects' median distance from where T predicts them, in units of tolerance."""
    distances = []
    for first, second, obj_id in shown:
        model = models.get(obj_id)
        equivalents = np.eye(4)[None] if model is None else model.equivalents
        size = 0.0 if model is None or np.isnan(model.measured) else model.measured
        away = (T @ first @ equivalents)[:, :3, 3] - second[:3, 3]
        distances.append(np.linalg.norm(away, axis=1).min() / (STILL + 0.1 * size))
    return float(np.median(distances))


def check_world(scene: Scene, reliable: np.ndarray, findings: Findings) -> None:
    """Checks that objects are static in the world frame; ``reliable`` as in `check_pairs`."""
    known = ~np.isnan(scene.T_cam_world).any(axis=(1, 2)) & rigid_or_nan(scene.T_cam_world)
    if known.sum() < 2:
        return
    world = dict(zip(scene.image_id[known].tolist(), scene.T_cam_world[known], strict=True))
    poses: dict[int, list[tuple[int, np.ndarray]]] = {}
    for (image_id, obj_id), T in _poses(scene, reliable).items():
        if image_id in world:
            poses.setdefault(obj_id, []).append((image_id, T))
    tracks = [track for track in poses.values() if len(track) > 1]
    if not tracks or _moving(tracks, world, lambda T: T) < 0.5:
        return
    explained = (r for r in _WORLD_READINGS if _moving(tracks, world, r[2]) < 0.1)
    unknown = (
        "the objects moved, or world and object poses are of different recordings",
        "omit cam_R_w2c and cam_t_w2c where objects move",
    )
    cause, remedy, *_ = next(explained, unknown)
    for image_id in world:
        findings.error(
            scene.camera_path, "cam_R_w2c, cam_t_w2c", "objects are not static in the world",
            place=Place(scene.scene_id, image_id), cause=cause, remedy=remedy,
            detail="object positions in the world differ between images",
        )  # fmt: skip


def _moving(
    tracks: Sequence[Sequence[tuple[int, np.ndarray]]],
    world: Mapping[int, np.ndarray],
    read: Callable[[np.ndarray], np.ndarray],
) -> float:
    """Returns the fraction of poses that are off their object's median position in the world."""
    off = []
    for track in tracks:
        places = np.stack([(invert(read(world[i])) @ T)[:3, 3] for i, T in track])
        distance = np.linalg.norm(places - np.median(places, axis=0), axis=1)
        off += (distance > STILL).tolist()
    return float(np.mean(off))


def _poses(scene: Scene, reliable: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    """Returns (image id, obj_id) -> pose of objects that an image shows once."""
    rows = scene.annotations
    found: dict[tuple[int, int], np.ndarray] = {}
    twice = set()
    for row, key in enumerate(zip(rows.image_id.tolist(), rows.obj_id.tolist(), strict=True)):
        if key in found:
            twice.add(key)
        if reliable[row]:
            found[key] = rows.T_cam_obj[row]
    return {key: T for key, T in found.items() if key not in twice}
