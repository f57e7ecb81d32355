"""Places clutter around one target so that its visibility follows LineMOD or LM-O.

LineMOD's targets are unoccluded. For LM-O, a target visibility is drawn from its distribution, and
arrangements are sampled, measured in small images, until one comes close.
"""

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
"""Arrangement, T_cam_world (4, 4) of the reference camera, visibility of the target in it."""


def place_unoccluded(request: ArrangementRequest) -> Placement:
    """LineMOD: the target's visibility is mostly >= 0.9, and >= 0.5 where possible."""
    search = _Search(request)
    min_visibility = 0.9 if search.rng.uniform() < 0.9 else 0.5
    for _ in range(4):
        arrangement = search.scatter(min_distance=(0.1, 0.4))
        T = search.place_camera(arrangement)
        if search.try_rotations(arrangement, T, 4, lambda v: max(0.0, min_visibility - v), 1e-9):
            break
    return search.result()


def place_occluded(request: ArrangementRequest) -> Placement:
    """LM-O's visibility, in clutter that may stand right next to the target."""
    search = _Search(request)
    return search.match_lmo(lambda: search.scatter(min_distance=(0.0, 0.25)))


def place_surrounded(request: ArrangementRequest) -> Placement:
    """LM-O's visibility, between tall props that occlude the target from many other sides."""
    search = _Search(request)
    return search.match_lmo(search.surround)


class _Search:
    def __init__(self, request: ArrangementRequest) -> None:
        self.scene, self.rng, self.target = request.scene, request.rng, request.target
        self.cameras, self.given = request.cameras, request.T_cam_world
        self.config = self.scene.config
        self.best: tuple[float, Arrangement, np.ndarray, float] | None = None

    def match_lmo(self, arrange: Callable[[], Arrangement]) -> Placement:
        """Draws a visibility from LM-O's; rotates the table, then slides an occluder, to match."""
        visibility = float(np.interp(self.rng.uniform(), *LMO_VISIBILITY))
        low = self.cameras.elevation[0]
        top = min(self.cameras.elevation[1], max(low, np.deg2rad(35.0 + 50.0 * visibility)))
        self.cameras = replace(self.cameras, elevation=(low, top))

        def error(measured: float) -> float:
            return abs(measured - visibility)

        for _ in range(3):
            arrangement = arrange()
            T = self.place_camera(arrangement)
            if self.try_rotations(arrangement, T, _ROTATIONS, error, _TOLERANCE):
                break
            if self.slide_occluder(visibility):
                break
        return self.result()

    def result(self) -> Placement:
        """Returns the best arrangement that was measured."""
        assert self.best is not None
        return self.best[1:]

    def scatter(self, min_distance: tuple[float, float]) -> Arrangement:
        """Places the target near the table's center and clutter around it."""
        table = self.target_alone()
        self.add_objects(table, min_distance)
        self.add_shapes(table, min_distance)
        return table

    def surround(self) -> Arrangement:
        """Packs tall shapes around the target, boxes first, then objects."""
        table = self.target_alone()
        self.add_shapes(table, (0.0, 0.0), tall=True)
        self.add_objects(table, (0.0, 0.0))
        return table

    def target_alone(self) -> Arrangement:
        """Places the target near the table's center, and nothing else."""
        xy = self.rng.uniform(-0.12, 0.12, 2)
        poses = self.scene.stable_poses[self.target]
        rest = sample_resting_pose(self.rng, poses, self.config.upright_probability)
        placed = PlacedObject(rest, xy, self.rng.uniform(-np.pi, np.pi))
        return Arrangement({self.target: Prop(placed)}, {})

    def add_objects(self, table: Arrangement, min_distance: tuple[float, float]) -> None:
        """Places other objects around the target, at a minimum distance drawn from this range."""
        rng, config = self.rng, self.config
        others = [name for name in self.scene.stable_poses if name != self.target]
        count = int(rng.integers(*config.object_count, endpoint=True))
        for k in rng.permutation(len(others))[:count]:
            poses = self.scene.stable_poses[others[k]]
            rest = sample_resting_pose(rng, poses, config.clutter_upright_probability)
            placed = self.pack_around_target(table, rest, min_distance)
            if placed is not None:
                table.objects[others[k]] = Prop(placed)

    def add_shapes(
        self, table: Arrangement, min_distance: tuple[float, float], tall: bool = False
    ) -> None:
        """Places plain shapes around the target; tall ones are boxes if possible."""
        rng, config = self.rng, self.config
        count = int(rng.integers(*config.shape_count, endpoint=True))
        kinds = rng.permutation(len(SHAPE_KINDS))
        if tall:
            kinds = kinds[np.argsort([SHAPE_KINDS[k] != "box" for k in kinds], kind="stable")]
        for k in kinds[:count]:
            size = sample_shape_size(rng, SHAPE_KINDS[k], tall)
            rest = resting_shape(SHAPE_KINDS[k], size)
            placed = self.pack_around_target(table, rest, min_distance)
            if placed is not None:
                table.shapes[int(k)] = Prop(placed, size)

    def pack_around_target(
        self, table: Arrangement, rest: StablePose, min_distance: tuple[float, float]
    ) -> PlacedObject | None:
        """Places one more prop in a random direction from the target; None if it does not fit."""
        xy = table.objects[self.target].placed.xy
        distance = self.rng.uniform(*min_distance)
        return pack(self.rng, rest, table.placed(), xy, distance)

    def place_camera(self, arrangement: Arrangement) -> np.ndarray:
        """Returns a reference camera whose image contains the target."""
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
        error: Callable[[float], float],
        tolerance: float,
    ) -> bool:
        """Rotates the table under the camera in steps; returns whether one is within tolerance."""
        center = arrangement.objects[self.target].placed.xy
        start = self.rng.uniform(-np.pi, np.pi)
        for k in range(count):
            rotated = arrangement.rotated(center, start + 2 * np.pi * k / count)
            if not all(on_table(p) for p in rotated.placed()):
                continue
            if self.measure(rotated, T_cam_world, error)[1] <= tolerance:
                return True
        if self.best is None:
            self.measure(arrangement, T_cam_world, error)
        return False

    def slide_occluder(self, target_visibility: float) -> bool:
        """Slides a prop sideways between camera and target until the visibility matches.

        It occludes more the closer it is to the line of sight, so a bisection finds its place.
        """
        assert self.best is not None
        _, base, T_cam_world, visibility = self.best
        if visibility < target_visibility:
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
                candidate = base.with_prop(name, moved)
                if not all(on_table(p) for p in candidate.placed()):
                    break
                visibility, error = self.measure(
                    candidate, T_cam_world, lambda v: abs(v - target_visibility)
                )
                if error <= _TOLERANCE:
                    return True
                if visibility < target_visibility:
                    near = lateral
                elif step == 0:
                    break  # too small to occlude enough
                else:
                    far = lateral
        return False

    def occluders(self, base: Arrangement) -> list[tuple[str | int, Prop]]:
        """Returns candidate occluders: two tall neighbors, then a box that is tall enough."""
        target = base.objects[self.target].placed.rest
        tall: list[tuple[str | int, Prop]] = [
            (name, prop)
            for name, prop in base.objects.items()
            if name != self.target and prop.placed.rest.height > 0.6 * target.height
        ]
        chosen = [tall[i] for i in self.rng.permutation(len(tall))[:2]]
        boxes = [i for i, kind in enumerate(SHAPE_KINDS) if kind == "box" and i not in base.shapes]
        if boxes:
            half_width = self.rng.uniform(0.6, 1.0) * target.radius
            half_height = 0.5 * target.height * self.rng.uniform(0.9, 1.4)
            size = np.clip((half_width, self.rng.uniform(0.015, 0.05), half_height), 0.015, 0.16)
            angle = self.rng.uniform(-np.pi, np.pi)
            box = PlacedObject(resting_shape("box", size), np.zeros(2), angle)
            chosen.append((boxes[0], Prop(box, size)))
        return chosen

    def measure(
        self, arrangement: Arrangement, T_cam_world: np.ndarray, error: Callable[[float], float]
    ) -> tuple[float, float]:
        """Measures the target's visibility and its error; keeps the best arrangement."""
        self.scene.show(arrangement)
        visibility = float(self.scene.probe_visibility([self.target], T_cam_world)[0])
        deviation = error(visibility)
        if self.best is None or deviation < self.best[0]:
            self.best = (deviation, arrangement, T_cam_world, visibility)
        return visibility, deviation
