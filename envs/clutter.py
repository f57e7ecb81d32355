"""Chooses what stands around one target, so that the camera sees as much of it as it should.

LineMOD's targets stand in full view. LM-O's are hidden behind their neighbours: a wished visibility
is drawn from LM-O's distribution, and arrangements are tried, measured by small pictures, until
one comes near.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    draw_tall_size,
    framing_camera,
    joined,
    target_visibility,
)
from .camera import CameraRange
from .placement import Placed, Resting, on_table, pack, resting_shape
from .world import SHAPE_KINDS, TABLE_HALF

if TYPE_CHECKING:
    from .scene import Scene

_TOLERANCE = 0.03
_ROTATIONS = 6
_BISECTIONS = 6


def arrange_clutter(
    scene: Scene,
    rng: np.random.Generator,
    target: str,
    resting: Mapping[str, list[Resting]],
    camera: CameraRange,
    T_cam_world: np.ndarray | None,
) -> tuple[Arrangement, np.ndarray, float]:
    """Arranges the table and places the reference camera; the scene then shows the result.

    Args:
        scene: shows arrangements and measures visibility.
        rng: decides everything.
        target: name of the target.
        resting: for each object the ways it rests.
        camera: where the reference camera may stand.
        T_cam_world: the camera if it is given, (4, 4).

    Returns:
        The arrangement, the camera and the target's visibility in it.
    """
    search = _Search(scene, rng, target, resting, camera, T_cam_world)
    if scene.config.kind == "linemod":
        return search.in_full_view()
    return search.hidden()


class _Search:
    def __init__(
        self,
        scene: Scene,
        rng: np.random.Generator,
        target: str,
        resting: Mapping[str, list[Resting]],
        camera: CameraRange,
        T_cam_world: np.ndarray | None,
    ) -> None:
        self.scene, self.rng, self.target, self.resting = scene, rng, target, resting
        self.range, self.given = camera, T_cam_world
        self.config = scene.config
        self.vertices = scene.objects[target].vertices
        self.best: tuple[float, Arrangement, np.ndarray, float] | None = None

    def in_full_view(self) -> tuple[Arrangement, np.ndarray, float]:
        """LineMOD: mostly 0.9 and more of the target is seen, never less than half if avoidable."""
        least = 0.9 if self.rng.uniform() < 0.9 else 0.5
        for _ in range(4):
            arrangement = self.scatter(nearest=(0.1, 0.4))
            T = self.place_camera(arrangement)
            if self.try_rotations(arrangement, T, 4, lambda v: max(0.0, least - v), 1e-9):
                break
        return self.result()

    def hidden(self) -> tuple[Arrangement, np.ndarray, float]:
        """LM-O: a wished visibility, approached by turning the table, then by an occluder."""
        walled = self.config.kind == "occlusion"
        wish = float(np.interp(self.rng.uniform(), *LMO_VISIBILITY))
        low = self.range.elevation[0]
        top = min(self.range.elevation[1], max(low, np.deg2rad(35.0 + 50.0 * wish)))
        self.range = replace(self.range, elevation=(low, top))

        def miss(visibility: float) -> float:
            return abs(visibility - wish)

        for _ in range(3):
            arrangement = self.surround() if walled else self.scatter(nearest=(0.0, 0.25))
            T = self.place_camera(arrangement)
            if self.try_rotations(arrangement, T, _ROTATIONS, miss, _TOLERANCE):
                break
            if self.slide_occluder(wish):
                break
        return self.result()

    def result(self) -> tuple[Arrangement, np.ndarray, float]:
        assert self.best is not None
        _, arrangement, T_cam_world, visibility = self.best
        self.scene.show(arrangement)
        return arrangement, T_cam_world, visibility

    def scatter(self, nearest: tuple[float, float]) -> Arrangement:
        """Puts the target near the table's middle and clutter around it."""
        table = self.target_alone()
        self.add_objects(table, nearest)
        self.add_shapes(table, nearest)
        return table

    def surround(self) -> Arrangement:
        """Puts tall things close around the target, boxes first, then objects as close as fits."""
        table = self.target_alone()
        self.add_shapes(table, (0.0, 0.0), tall=True)
        self.add_objects(table, (0.0, 0.0))
        return table

    def target_alone(self) -> Arrangement:
        """The target near the table's middle, and nothing else."""
        xy = self.rng.uniform(-0.12, 0.12, 2)
        rest = draw_rest(self.rng, self.resting[self.target], self.config.upright_probability)
        placed = Placed(rest, xy, self.rng.uniform(-np.pi, np.pi))
        return Arrangement({self.target: Thing(placed)}, {})

    def add_objects(self, table: Arrangement, nearest: tuple[float, float]) -> None:
        """Puts other objects around the target, at least a drawn distance away, where they fit."""
        rng, config = self.rng, self.config
        others = [name for name in self.resting if name != self.target]
        count = min(
            len(others), int(rng.integers(config.object_count[0], config.object_count[1] + 1))
        )
        for k in rng.permutation(len(others))[:count]:
            rest = draw_rest(rng, self.resting[others[k]], config.clutter_upright_probability)
            fitted = self.beside_target(table, rest, nearest)
            if fitted is not None:
                table.objects[others[k]] = Thing(fitted)

    def add_shapes(
        self, table: Arrangement, nearest: tuple[float, float], tall: bool = False
    ) -> None:
        """Puts plain shapes around the target where they fit; tall ones are boxes if possible."""
        rng, config = self.rng, self.config
        count = int(rng.integers(config.shape_count[0], config.shape_count[1] + 1))
        kinds = rng.permutation(len(SHAPE_KINDS))
        if tall:
            kinds = kinds[np.argsort([SHAPE_KINDS[k] != "box" for k in kinds], kind="stable")]
        for k in kinds[:count]:
            size = (draw_tall_size if tall else draw_size)(rng, SHAPE_KINDS[k])
            fitted = self.beside_target(table, resting_shape(SHAPE_KINDS[k], size), nearest)
            if fitted is not None:
                table.shapes[int(k)] = Thing(fitted, size)

    def beside_target(
        self, table: Arrangement, rest: Resting, nearest: tuple[float, float]
    ) -> Placed | None:
        """A place for one more thing in a random direction from the target."""
        xy = table.objects[self.target].placed.xy
        distance = self.rng.uniform(*nearest)
        return pack(self.rng, rest, table.placed(), xy, distance, TABLE_HALF)

    def place_camera(self, arrangement: Arrangement) -> np.ndarray:
        """A reference camera whose picture holds the whole target."""
        if self.given is not None:
            return self.given
        placed = arrangement.objects[self.target].placed
        centre = np.append(placed.xy, placed.resting.height / 2)
        points = transform(placed.T_world_obj, self.vertices)
        return framing_camera(self.range, self.rng, centre, points, tries=10)

    def try_rotations(
        self,
        arrangement: Arrangement,
        T_cam_world: np.ndarray,
        count: int,
        miss: Callable[[float], float],
        enough: float,
    ) -> bool:
        """Turns the table under the camera in steps; whether one comes near enough."""
        centre = arrangement.objects[self.target].placed.xy
        start = self.rng.uniform(-np.pi, np.pi)
        for k in range(count):
            turned = arrangement.rotated(centre, start + 2 * np.pi * k / count)
            if not all(on_table(p, TABLE_HALF) for p in turned.placed()):
                continue
            if self.measure(turned, T_cam_world, miss)[1] <= enough:
                return True
        if self.best is None:
            self.measure(arrangement, T_cam_world, miss)
        return False

    def slide_occluder(self, wish: float) -> bool:
        """Slides something sideways between camera and target until enough of it is hidden.

        The nearer it is to the line of sight the more it hides, so a bisection finds its place.
        """
        assert self.best is not None
        _, base, T_cam_world, visibility = self.best
        if visibility < wish:
            return False
        target = base.objects[self.target].placed
        towards = -T_cam_world[:3, :3].T @ T_cam_world[:3, 3]
        towards = towards[:2] - target.xy
        towards /= max(float(np.linalg.norm(towards)), 1e-9)
        sideways = np.array([-towards[1], towards[0]]) * self.rng.choice((-1.0, 1.0))
        for name, occluder in self.occluders(base):
            reach = target.resting.radius + occluder.placed.resting.radius + 0.004
            near, far = 0.0, reach
            for step in range(_BISECTIONS):
                lateral = near if step == 0 else (near + far) / 2
                xy = target.xy + reach * towards + lateral * sideways
                tried = joined(base, name, replace(occluder, placed=occluder.placed.moved(xy)))
                if not all(on_table(p, TABLE_HALF) for p in tried.placed()):
                    break
                visibility, missed = self.measure(tried, T_cam_world, lambda v: abs(v - wish))
                if missed <= _TOLERANCE:
                    return True
                if visibility < wish:
                    near = lateral
                elif step == 0:
                    break  # too small to hide enough
                else:
                    far = lateral
        return False

    def occluders(self, base: Arrangement) -> list[tuple[str | int, Thing]]:
        """Things to hide the target behind: two tall neighbours, then a box that is tall enough."""
        target = base.objects[self.target].placed.resting
        tall: list[tuple[str | int, Thing]] = [
            (name, thing)
            for name, thing in base.objects.items()
            if name != self.target and thing.placed.resting.height > 0.6 * target.height
        ]
        chosen = [tall[i] for i in self.rng.permutation(len(tall))[:2]]
        boxes = [i for i, kind in enumerate(SHAPE_KINDS) if kind == "box" and i not in base.shapes]
        if boxes:
            wide = self.rng.uniform(0.6, 1.0) * target.radius
            high = 0.5 * target.height * self.rng.uniform(0.9, 1.4)
            size = np.clip((wide, self.rng.uniform(0.015, 0.05), high), 0.015, 0.16)
            angle = self.rng.uniform(-np.pi, np.pi)
            box = Placed(resting_shape("box", size), np.zeros(2), angle)
            chosen.append((boxes[0], Thing(box, size)))
        return chosen

    def measure(
        self, arrangement: Arrangement, T_cam_world: np.ndarray, miss: Callable[[float], float]
    ) -> tuple[float, float]:
        """Shows an arrangement and keeps it if it is the best so far; its visibility and miss."""
        self.scene.show(arrangement)
        T_world_obj = arrangement.objects[self.target].placed.T_world_obj
        visibility = target_visibility(self.scene, self.target, T_world_obj, T_cam_world)
        missed = miss(visibility)
        if self.best is None or missed < self.best[0]:
            self.best = (missed, arrangement, T_cam_world, visibility)
        return visibility, missed
