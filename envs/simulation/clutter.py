"""Chooses what stands around one target, so that the camera sees as much of it as it should.

LineMOD's targets stand in full view. LM-O's are hidden behind their neighbors: a target visibility
is drawn from LM-O's distribution, and arrangements are tried, measured in small images, until one
comes near.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...core.geometry import transform
from .arrangement import (
    LMO_VISIBILITY,
    Arrangement,
    Prop,
    framing_camera,
    sample_resting_pose,
    sample_shape_size,
)
from .camera import camera_center
from .placement import PlacedObject, StablePose, on_table, pack, resting_shape
from .scene import ArrangementRequest
from .world import SHAPE_KINDS

_TOLERANCE = 0.03
_ROTATIONS = 6
_BISECTIONS = 6

Placement = tuple[Arrangement, np.ndarray, float]
"""An arrangement, the reference camera (4, 4), and the target's visibility in it."""


def place_unoccluded(request: ArrangementRequest) -> Placement:
    """LineMOD: mostly 0.9 and more of the target is seen, never less than half if avoidable."""
    search = _Search(request)
    least = 0.9 if search.rng.uniform() < 0.9 else 0.5
    for _ in range(4):
        arrangement = search.scatter(nearest=(0.1, 0.4))
        T = search.place_camera(arrangement)
        if search.try_rotations(arrangement, T, 4, lambda v: max(0.0, least - v), 1e-9):
            break
    return search.result()


def place_occluded(request: ArrangementRequest) -> Placement:
    """LM-O's visibility, among clutter that may touch the target."""
    search = _Search(request)
    return search.approach_lmo(lambda: search.scatter(nearest=(0.0, 0.25)))


def place_surrounded(request: ArrangementRequest) -> Placement:
    """LM-O's visibility, between tall props that hide the target from many other sides."""
    search = _Search(request)
    return search.approach_lmo(search.surround)


class _Search:
    def __init__(self, request: ArrangementRequest) -> None:
        self.scene, self.rng, self.target = request.scene, request.rng, request.target
        self.cameras, self.given = request.cameras, request.T_cam_world
        self.config = self.scene.config
        self.best: tuple[float, Arrangement, np.ndarray, float] | None = None

    def approach_lmo(self, arrange: Callable[[], Arrangement]) -> Placement:
        """A visibility drawn from LM-O's, approached by turning the table, then by an occluder."""
        wanted = float(np.interp(self.rng.uniform(), *LMO_VISIBILITY))
        low = self.cameras.elevation[0]
        top = min(self.cameras.elevation[1], max(low, np.deg2rad(35.0 + 50.0 * wanted)))
        self.cameras = replace(self.cameras, elevation=(low, top))

        def miss(visibility: float) -> float:
            return abs(visibility - wanted)

        for _ in range(3):
            arrangement = arrange()
            T = self.place_camera(arrangement)
            if self.try_rotations(arrangement, T, _ROTATIONS, miss, _TOLERANCE):
                break
            if self.slide_occluder(wanted):
                break
        return self.result()

    def result(self) -> Placement:
        """The best arrangement that was measured."""
        assert self.best is not None
        return self.best[1:]

    def scatter(self, nearest: tuple[float, float]) -> Arrangement:
        """Puts the target near the table's middle and clutter around it."""
        table = self.target_alone()
        self.add_objects(table, nearest)
        self.add_shapes(table, nearest)
        return table

    def surround(self) -> Arrangement:
        """Puts tall props close around the target, boxes first, then objects as close as fits."""
        table = self.target_alone()
        self.add_shapes(table, (0.0, 0.0), tall=True)
        self.add_objects(table, (0.0, 0.0))
        return table

    def target_alone(self) -> Arrangement:
        """The target near the table's middle, and nothing else."""
        xy = self.rng.uniform(-0.12, 0.12, 2)
        poses = self.scene.stable_poses[self.target]
        rest = sample_resting_pose(self.rng, poses, self.config.upright_probability)
        placed = PlacedObject(rest, xy, self.rng.uniform(-np.pi, np.pi))
        return Arrangement({self.target: Prop(placed)}, {})

    def add_objects(self, table: Arrangement, nearest: tuple[float, float]) -> None:
        """Puts other objects around the target, at least a drawn distance away, where they fit."""
        rng, config = self.rng, self.config
        others = [name for name in self.scene.stable_poses if name != self.target]
        count = int(rng.integers(*config.object_count, endpoint=True))
        for k in rng.permutation(len(others))[:count]:
            poses = self.scene.stable_poses[others[k]]
            rest = sample_resting_pose(rng, poses, config.clutter_upright_probability)
            fitted = self.beside_target(table, rest, nearest)
            if fitted is not None:
                table.objects[others[k]] = Prop(fitted)

    def add_shapes(
        self, table: Arrangement, nearest: tuple[float, float], tall: bool = False
    ) -> None:
        """Puts plain shapes around the target where they fit; tall ones are boxes if possible."""
        rng, config = self.rng, self.config
        count = int(rng.integers(*config.shape_count, endpoint=True))
        kinds = rng.permutation(len(SHAPE_KINDS))
        if tall:
            kinds = kinds[np.argsort([SHAPE_KINDS[k] != "box" for k in kinds], kind="stable")]
        for k in kinds[:count]:
            size = sample_shape_size(rng, SHAPE_KINDS[k], tall)
            fitted = self.beside_target(table, resting_shape(SHAPE_KINDS[k], size), nearest)
            if fitted is not None:
                table.shapes[int(k)] = Prop(fitted, size)

    def beside_target(
        self, table: Arrangement, rest: StablePose, nearest: tuple[float, float]
    ) -> PlacedObject | None:
        """A place for one more prop in a random direction from the target."""
        xy = table.objects[self.target].placed.xy
        distance = self.rng.uniform(*nearest)
        return pack(self.rng, rest, table.placed(), xy, distance)

    def place_camera(self, arrangement: Arrangement) -> np.ndarray:
        """A reference camera whose image holds the whole target."""
        if self.given is not None:
            return self.given
        placed = arrangement.objects[self.target].placed
        center = np.append(placed.xy, placed.rest.height / 2)
        points = transform(placed.T_world_obj, self.scene.objects[self.target].vertices)
        return framing_camera(self.cameras, self.rng, center, points, tries=10)

    def try_rotations(
        self,
        arrangement: Arrangement,
        T_cam_world: np.ndarray,
        count: int,
        miss: Callable[[float], float],
        enough: float,
    ) -> bool:
        """Turns the table under the camera in steps; whether one comes near enough."""
        center = arrangement.objects[self.target].placed.xy
        start = self.rng.uniform(-np.pi, np.pi)
        for k in range(count):
            turned = arrangement.rotated(center, start + 2 * np.pi * k / count)
            if not all(on_table(p) for p in turned.placed()):
                continue
            if self.measure(turned, T_cam_world, miss)[1] <= enough:
                return True
        if self.best is None:
            self.measure(arrangement, T_cam_world, miss)
        return False

    def slide_occluder(self, wanted: float) -> bool:
        """Slides something sideways between camera and target until enough of it is hidden.

        The nearer it is to the line of sight the more it hides, so a bisection finds its place.
        """
        assert self.best is not None
        _, base, T_cam_world, visibility = self.best
        if visibility < wanted:
            return False
        target = base.objects[self.target].placed
        towards = camera_center(T_cam_world)[:2] - target.xy
        towards /= max(float(np.linalg.norm(towards)), 1e-9)
        sideways = np.array([-towards[1], towards[0]]) * self.rng.choice((-1.0, 1.0))
        for name, occluder in self.occluders(base):
            reach = target.rest.radius + occluder.placed.rest.radius + 0.004
            near, far = 0.0, reach
            for step in range(_BISECTIONS):
                lateral = near if step == 0 else (near + far) / 2
                xy = target.xy + reach * towards + lateral * sideways
                moved = replace(occluder, placed=replace(occluder.placed, xy=xy))
                tried = base.with_prop(name, moved)
                if not all(on_table(p) for p in tried.placed()):
                    break
                visibility, missed = self.measure(tried, T_cam_world, lambda v: abs(v - wanted))
                if missed <= _TOLERANCE:
                    return True
                if visibility < wanted:
                    near = lateral
                elif step == 0:
                    break  # too small to hide enough
                else:
                    far = lateral
        return False

    def occluders(self, base: Arrangement) -> list[tuple[str | int, Prop]]:
        """Props to hide the target behind: two tall neighbors, then a box that is tall enough."""
        target = base.objects[self.target].placed.rest
        tall: list[tuple[str | int, Prop]] = [
            (name, prop)
            for name, prop in base.objects.items()
            if name != self.target and prop.placed.rest.height > 0.6 * target.height
        ]
        chosen = [tall[i] for i in self.rng.permutation(len(tall))[:2]]
        boxes = [i for i, kind in enumerate(SHAPE_KINDS) if kind == "box" and i not in base.shapes]
        if boxes:
            wide = self.rng.uniform(0.6, 1.0) * target.radius
            high = 0.5 * target.height * self.rng.uniform(0.9, 1.4)
            size = np.clip((wide, self.rng.uniform(0.015, 0.05), high), 0.015, 0.16)
            angle = self.rng.uniform(-np.pi, np.pi)
            box = PlacedObject(resting_shape("box", size), np.zeros(2), angle)
            chosen.append((boxes[0], Prop(box, size)))
        return chosen

    def measure(
        self, arrangement: Arrangement, T_cam_world: np.ndarray, miss: Callable[[float], float]
    ) -> tuple[float, float]:
        """Shows an arrangement and keeps it if it is the best so far; its visibility and miss."""
        self.scene.show(arrangement)
        visibility = float(self.scene.probe_visibility([self.target], T_cam_world)[0])
        missed = miss(visibility)
        if self.best is None or missed < self.best[0]:
            self.best = (missed, arrangement, T_cam_world, visibility)
        return visibility, missed
