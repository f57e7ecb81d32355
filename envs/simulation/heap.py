"""The scene kind ``heap``: dense clutter, all upright, of the Occlusion-style test.

As in LM-O, all objects are targets at once and occlude each other. The clutter is rotated under the
reference camera to bring their visibilities close to samples of LM-O's distribution.
"""

from dataclasses import replace

import numpy as np

from .arrangement import (
    LMO_VISIBILITY,
    Arrangement,
    Prop,
    framing_camera,
    sample_resting_pose,
    sample_shape_size,
)
from .placement import PlacedObject, StablePose, pack, resting_shape
from .scene import ArrangementRequest
from .world import SHAPE_KINDS

LMO_ELEVATION = ((0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0), (7.0, 10.0, 17.0, 32.0, 47.0, 71.0, 85.0))
"""Quantiles of LM-O's camera elevation: probabilities and degrees."""

_PROBE_SIZE = 160
_CAMERA_TRIES = 12
_DIRECTIONS = (2, 6)
_ROTATIONS = 8


def place_heap(request: ArrangementRequest) -> tuple[Arrangement, np.ndarray, float]:
    """Packs objects densely; see :class:`~.scene.ArrangementRequest` for what it returns."""
    scene, rng = request.scene, request.rng
    packed = _pack_densely(request)
    scene.show(packed)
    names = tuple(packed.objects)
    center = packed.center()
    T = _sample_camera(request, center) if request.T_cam_world is None else request.T_cam_world
    strata = (rng.permutation(len(names)) + rng.uniform(size=len(names))) / len(names)
    target = np.sort(np.interp(strata, *LMO_VISIBILITY))
    start = rng.uniform(-np.pi, np.pi)
    best, best_error, best_visibility = packed, np.inf, np.zeros(len(names))
    for k in range(_ROTATIONS):
        rotated = packed.rotated(center[:2], start + 2 * np.pi * k / _ROTATIONS)
        scene.show(rotated)
        visibility = scene.probe_visibility(names, T, _PROBE_SIZE)
        error = float(np.abs(np.sort(visibility) - target).sum())
        if error < best_error:
            best, best_error, best_visibility = rotated, error, visibility
    return best, T, float(best_visibility[names.index(request.target)])


def _pack_densely(request: ArrangementRequest) -> Arrangement:
    """Packs each prop from a few directions and keeps the place closest to the center."""
    scene, rng, config = request.scene, request.rng, request.scene.config
    others = [name for name in scene.stable_poses if name != request.target]
    low, high = (min(len(others), count) for count in config.object_count)
    count = int(rng.integers(low, high, endpoint=True))
    names = [request.target, *(others[k] for k in rng.permutation(len(others))[:count])]
    center = rng.uniform(-0.1, 0.1, 2)
    objects: dict[str, Prop] = {}
    shapes: dict[int, Prop] = {}
    placed: list[PlacedObject] = []
    for k in rng.permutation(len(names)):
        poses = scene.stable_poses[names[k]]
        rest = sample_resting_pose(rng, poses, config.upright_probability)
        placed.append(_pack_closest(rng, rest, placed, center))
        objects[names[k]] = Prop(placed[-1])
    count = int(rng.integers(*config.shape_count, endpoint=True))
    for k in rng.permutation(len(SHAPE_KINDS))[:count]:
        size = sample_shape_size(rng, SHAPE_KINDS[k])
        placed.append(_pack_closest(rng, resting_shape(SHAPE_KINDS[k], size), placed, center))
        shapes[int(k)] = Prop(placed[-1], size)
    return Arrangement({name: objects[name] for name in names}, shapes)


def _pack_closest(
    rng: np.random.Generator, rest: StablePose, others: list[PlacedObject], center: np.ndarray
) -> PlacedObject:
    count = int(rng.integers(*_DIRECTIONS, endpoint=True))
    candidates: list[PlacedObject] = []
    while len(candidates) < count:
        placed = pack(rng, rest, others, center)
        if placed is not None:
            candidates.append(placed)
    return min(candidates, key=lambda placed: float(np.linalg.norm(placed.xy - center)))


def _sample_camera(request: ArrangementRequest, center: np.ndarray) -> np.ndarray:
    """Samples a camera that sees all objects, or most of them; elevations are LM-O's."""
    scene, rng = request.scene, request.rng
    elevation = np.deg2rad(np.interp(rng.uniform(), *LMO_ELEVATION))
    elevation = float(np.clip(elevation, *request.cameras.elevation))
    cameras = replace(request.cameras, elevation=(elevation, elevation))
    points = scene.surface(tuple(scene.arrangement.objects))
    return framing_camera(cameras, rng, center, points, _CAMERA_TRIES)
