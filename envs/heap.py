"""Objects close together, each hiding some of the others: the scenes of the Occlusion-style test.

LM-O looks at eight objects of one crowded table and asks for all of them. So does a heap: all its
objects are targets at once. How much of each is seen from the reference camera comes near a draw
from LM-O's distribution, as the heap is turned under the camera until it does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..pose_estimator.geometry import transform
from .arrangement import (
    LMO_VISIBILITY,
    Arrangement,
    Thing,
    draw_rest,
    draw_size,
    framing_camera,
    probe_camera,
)
from .camera import CameraRange
from .placement import Placed, Resting, pack, resting_shape
from .world import SHAPE_KINDS, TABLE_HALF

if TYPE_CHECKING:
    from .scene import Scene

LMO_ELEVATION = ((0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0), (7.0, 10.0, 17.0, 32.0, 47.0, 71.0, 85.0))
"""Quantiles of the camera's elevation above LM-O's table: probabilities and degrees."""

PROBE_SIZE = 160
_TRIES = 12
_DIRECTIONS = (2, 6)
_ROTATIONS = 8


def arrange_heap(
    scene: Scene,
    rng: np.random.Generator,
    target: str,
    resting: Mapping[str, list[Resting]],
    camera: CameraRange,
    T_cam_world: np.ndarray | None,
) -> tuple[Arrangement, np.ndarray, float]:
    """Heaps objects up and places the reference camera; the scene then shows the result.

    Args:
        scene: shows arrangements and measures visibility.
        rng: decides everything.
        target: name of an object that is in the heap for certain.
        resting: for each object the ways it rests.
        camera: where the reference camera may stand around the heap's middle.
        T_cam_world: the camera if it is given, (4, 4).

    Returns:
        The arrangement, the camera and the target's visibility in it.
    """
    heap = _heap(scene, rng, target, resting)
    names = tuple(heap.objects)
    middle = heap_middle(heap)
    T = _camera(scene, rng, heap, middle, camera) if T_cam_world is None else T_cam_world
    strata = (rng.permutation(len(names)) + rng.uniform(size=len(names))) / len(names)
    wish = np.sort(np.interp(strata, *LMO_VISIBILITY))
    start = rng.uniform(-np.pi, np.pi)
    best, best_miss, best_visibility = heap, np.inf, np.zeros(len(names))
    for k in range(_ROTATIONS):
        turned = heap.rotated(middle[:2], start + 2 * np.pi * k / _ROTATIONS)
        scene.show(turned)
        K = probe_camera(transform(T, _surface(scene, turned)), PROBE_SIZE)
        if K is None:
            continue
        visibility = scene.visibilities(names, T, K, PROBE_SIZE)
        miss = float(np.abs(np.sort(visibility) - wish).sum())
        if miss < best_miss:
            best, best_miss, best_visibility = turned, miss, visibility
    scene.show(best)
    return best, T, float(best_visibility[names.index(target)])


def heap_middle(heap: Arrangement) -> np.ndarray:
    """The point in the middle of the heap's objects, (3,) metres, world."""
    placed = [thing.placed for thing in heap.objects.values()]
    xy = np.mean([p.xy for p in placed], axis=0)
    return np.append(xy, np.mean([p.resting.height for p in placed]) / 2)


def _heap(
    scene: Scene, rng: np.random.Generator, target: str, resting: Mapping[str, list[Resting]]
) -> Arrangement:
    """Each thing slides up to the heap from a few directions and stays where it came nearest."""
    config = scene.config
    others = [name for name in resting if name != target]
    fewest, most = (min(len(others), count) for count in config.object_count)
    count = int(rng.integers(fewest, most + 1))
    names = [target, *(others[k] for k in rng.permutation(len(others))[:count])]
    middle = rng.uniform(-0.1, 0.1, 2)
    objects: dict[str, Thing] = {}
    shapes: dict[int, Thing] = {}
    placed: list[Placed] = []
    for k in rng.permutation(len(names)):
        rest = draw_rest(rng, resting[names[k]], config.upright_probability)
        placed.append(_nearest(rng, rest, placed, middle))
        objects[names[k]] = Thing(placed[-1])
    count = int(rng.integers(config.shape_count[0], config.shape_count[1] + 1))
    for k in rng.permutation(len(SHAPE_KINDS))[:count]:
        size = draw_size(rng, SHAPE_KINDS[k])
        placed.append(_nearest(rng, resting_shape(SHAPE_KINDS[k], size), placed, middle))
        shapes[int(k)] = Thing(placed[-1], size)
    return Arrangement({name: objects[name] for name in names}, shapes)


def _nearest(
    rng: np.random.Generator, rest: Resting, others: list[Placed], middle: np.ndarray
) -> Placed:
    wanted = int(rng.integers(_DIRECTIONS[0], _DIRECTIONS[1] + 1))
    found: list[Placed] = []
    while len(found) < wanted:
        fitted = pack(rng, rest, others, middle, 0.0, TABLE_HALF)
        if fitted is not None:
            found.append(fitted)
    return min(found, key=lambda thing: float(np.linalg.norm(thing.xy - middle)))


def _camera(
    scene: Scene,
    rng: np.random.Generator,
    heap: Arrangement,
    middle: np.ndarray,
    camera: CameraRange,
) -> np.ndarray:
    """A camera whose picture holds the whole heap, or most of it; elevations are LM-O's."""
    elevation = np.deg2rad(np.interp(rng.uniform(), *LMO_ELEVATION))
    elevation = float(np.clip(elevation, *camera.elevation))
    here = replace(camera, elevation=(elevation, elevation))
    return framing_camera(here, rng, middle, _surface(scene, heap), _TRIES)


def _surface(scene: Scene, heap: Arrangement) -> np.ndarray:
    """The vertices of all objects, (N, 3) metres, world."""
    return np.concatenate(
        [
            transform(thing.placed.T_world_obj, scene.objects[name].vertices)
            for name, thing in heap.objects.items()
        ]
    )
