"""Objects close together, each hiding some of the others: the scenes of the Occlusion-style test.

LM-O looks at eight objects of one crowded table and asks for all of them. So does a heap: all its
objects are targets at once. How much of each is seen from the reference camera comes near a draw
from LM-O's distribution, as the heap is turned under the camera until it does.
"""

from __future__ import annotations

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
"""Quantiles of the camera's elevation above LM-O's table: probabilities and degrees."""

PROBE_SIZE = 160
_TRIES = 12
_DIRECTIONS = (2, 6)
_ROTATIONS = 8


def place_heap(request: ArrangementRequest) -> tuple[Arrangement, np.ndarray, float]:
    """Puts objects close together and the reference camera where it sees all or most of them.

    Returns:
        The arrangement, the reference camera (4, 4) and the target's visibility in it.
    """
    scene, rng = request.scene, request.rng
    heap = _close_together(request)
    scene.show(heap)
    names = tuple(heap.objects)
    middle = heap.middle()
    T = _camera(request, middle) if request.T_cam_world is None else request.T_cam_world
    strata = (rng.permutation(len(names)) + rng.uniform(size=len(names))) / len(names)
    wanted = np.sort(np.interp(strata, *LMO_VISIBILITY))
    start = rng.uniform(-np.pi, np.pi)
    best, best_miss, best_visibility = heap, np.inf, np.zeros(len(names))
    for k in range(_ROTATIONS):
        turned = heap.rotated(middle[:2], start + 2 * np.pi * k / _ROTATIONS)
        scene.show(turned)
        visibility = scene.probe_visibility(names, T, PROBE_SIZE)
        miss = float(np.abs(np.sort(visibility) - wanted).sum())
        if miss < best_miss:
            best, best_miss, best_visibility = turned, miss, visibility
    return best, T, float(best_visibility[names.index(request.target)])


def _close_together(request: ArrangementRequest) -> Arrangement:
    """Each prop slides to the middle from a few directions and stays where it came nearest."""
    scene, rng, config = request.scene, request.rng, request.scene.config
    others = [name for name in scene.stable_poses if name != request.target]
    fewest, most = (min(len(others), count) for count in config.object_count)
    count = int(rng.integers(fewest, most, endpoint=True))
    names = [request.target, *(others[k] for k in rng.permutation(len(others))[:count])]
    middle = rng.uniform(-0.1, 0.1, 2)
    objects: dict[str, Prop] = {}
    shapes: dict[int, Prop] = {}
    placed: list[PlacedObject] = []
    for k in rng.permutation(len(names)):
        poses = scene.stable_poses[names[k]]
        rest = sample_resting_pose(rng, poses, config.upright_probability)
        placed.append(_nearest(rng, rest, placed, middle))
        objects[names[k]] = Prop(placed[-1])
    count = int(rng.integers(*config.shape_count, endpoint=True))
    for k in rng.permutation(len(SHAPE_KINDS))[:count]:
        size = sample_shape_size(rng, SHAPE_KINDS[k])
        placed.append(_nearest(rng, resting_shape(SHAPE_KINDS[k], size), placed, middle))
        shapes[int(k)] = Prop(placed[-1], size)
    return Arrangement({name: objects[name] for name in names}, shapes)


def _nearest(
    rng: np.random.Generator, rest: StablePose, others: list[PlacedObject], middle: np.ndarray
) -> PlacedObject:
    wanted = int(rng.integers(*_DIRECTIONS, endpoint=True))
    found: list[PlacedObject] = []
    while len(found) < wanted:
        fitted = pack(rng, rest, others, middle)
        if fitted is not None:
            found.append(fitted)
    return min(found, key=lambda placed: float(np.linalg.norm(placed.xy - middle)))


def _camera(request: ArrangementRequest, middle: np.ndarray) -> np.ndarray:
    """A camera whose image holds all objects, or most of them; elevations are LM-O's."""
    scene, rng = request.scene, request.rng
    elevation = np.deg2rad(np.interp(rng.uniform(), *LMO_ELEVATION))
    elevation = float(np.clip(elevation, *request.cameras.elevation))
    cameras = replace(request.cameras, elevation=(elevation, elevation))
    points = scene.surface(tuple(scene.arrangement.objects))
    return framing_camera(cameras, rng, middle, points, _TRIES)
