"""A table with a target, clutter and a reference camera: what an episode happens in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..assets.object_model import ObjectModel
from ..pose_estimator.geometry import check_rigid
from .arrangement import Arrangement, Thing
from .camera import CameraRange
from .clutter import arrange_clutter
from .gl import mujoco
from .graphics import Graphics
from .heap import arrange_heap
from .placement import resting_poses
from .randomization import Randomization, apply_randomization, neutral_look
from .world import HIDDEN, MOVABLE, SHAPE_KINDS, World, compile_world

KINDS = ("linemod", "clutter", "occlusion", "heap")
_OBJECT_COUNT = {"linemod": (3, 7), "clutter": (5, 8), "occlusion": (5, 8), "heap": (7, 7)}
_SHAPE_COUNT = {"linemod": (0, 4), "clutter": (2, 5), "occlusion": (4, 7), "heap": (0, 2)}


@dataclass(frozen=True)
class SceneConfig:
    """What stands on the table.

    Attributes:
        kind: "linemod" (light clutter, the target nearly always in full view), "clutter" (dense;
            the target's visibility is distributed as in LM-O), "occlusion" (the target stands
            between tall things and close neighbours; its visibility from the reference camera is
            distributed so too, but from many other sides it is hidden) or "heap" (eight objects
            close together, all upright; the visibility of all is distributed so).
        clutter_objects: fewest and most other objects; None takes the kind's own.
        plain_shapes: fewest and most boxes, cylinders and spheres; None takes the kind's own.
        upright_probability: how often the target stands upright.
        clutter_upright_probability: how often each other object does.
        camera: where the reference camera may stand around the target; roll and look-at noise are
            taken from the randomization.
    """

    kind: str = "linemod"
    clutter_objects: tuple[int, int] | None = None
    plain_shapes: tuple[int, int] | None = None
    upright_probability: float = 1.0
    clutter_upright_probability: float = 0.7
    camera: CameraRange = field(default_factory=CameraRange)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"scene kind must be one of {KINDS}, got {self.kind!r}")
        for name in ("clutter_objects", "plain_shapes"):
            count = getattr(self, name)
            if count is not None and not 0 <= count[0] <= count[1]:
                raise ValueError(f"{name} must be (fewest, most), got {count}")
        if self.plain_shapes is not None and self.plain_shapes[1] > len(SHAPE_KINDS):
            raise ValueError(f"plain_shapes must be at most {len(SHAPE_KINDS)}")
        for name in ("upright_probability", "clutter_upright_probability"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be 0 to 1, got {getattr(self, name)}")

    @property
    def object_count(self) -> tuple[int, int]:
        """Fewest and most other objects."""
        return self.clutter_objects or _OBJECT_COUNT[self.kind]

    @property
    def shape_count(self) -> tuple[int, int]:
        """Fewest and most plain shapes."""
        return self.plain_shapes or _SHAPE_COUNT[self.kind]


@dataclass(frozen=True, eq=False)
class SceneState:
    """What one reset set up.

    Attributes:
        target: name of the object to be found.
        T_world_obj: pose of every object present, target included, (4, 4) each.
        T_cam_world: the reference camera, (4, 4).
        visibility: visible fraction of the target's silhouette in the reference camera.
    """

    target: str
    T_world_obj: dict[str, np.ndarray]
    T_cam_world: np.ndarray
    visibility: float


class Scene:
    """Objects on a table. Compiled once; every reset only moves, recolours and relights.

    Args:
        objects: the objects by name; any of them can be the target.
        config: what stands on the table.
        randomization: how the look changes between resets.

    Raises:
        ValueError: if there are no objects, or one was stored without its mesh.
    """

    def __init__(
        self,
        objects: Mapping[str, ObjectModel],
        config: SceneConfig | None = None,
        randomization: Randomization | None = None,
    ) -> None:
        if not objects:
            raise ValueError("a scene needs at least one object, got none")
        for name, model in objects.items():
            if not model.has_surface:
                raise ValueError(
                    f"{name} cannot be drawn: it was stored without its mesh, as with weights for "
                    "objects that must not be passed on. Name its mesh file (--objects, objects=)"
                )
        self.objects = dict(objects)
        self.config = config or SceneConfig()
        self.randomization = randomization or Randomization()
        self.world: World = compile_world(self.objects)
        self.data = mujoco.MjData(self.world.model)
        self.texture_versions = np.zeros(self.world.model.ntex, dtype=np.int64)
        self.graphics = Graphics(self)
        self.state: SceneState | None = None
        self._resting = {name: resting_poses(model) for name, model in self.objects.items()}
        self._geoms = dict(zip(self.world.object_names, self.world.object_geoms, strict=True))
        self._touch(neutral_look(self.world))
        self._show(Arrangement({}, {}))

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of all objects that may appear."""
        return self.world.object_names

    @property
    def shadows(self) -> bool:
        """Whether a lamp that is lit casts shadows."""
        model = self.world.model
        return bool(np.any(model.light_castshadow & model.light_active))

    def reset(
        self, rng: np.random.Generator, target: str, T_cam_world: np.ndarray | None = None
    ) -> SceneState:
        """Sets up a new episode.

        Args:
            rng: decides everything; the same generator state gives the same scene.
            target: name of the object to be found.
            T_cam_world: the reference camera, (4, 4); drawn from ``config.camera`` if None.

        Raises:
            ValueError: if the target is unknown or the camera is not a rigid transform.
        """
        if target not in self.objects:
            raise ValueError(f"target must be one of {self.object_names}, got {target!r}")
        if T_cam_world is not None:
            T_cam_world = check_rigid(T_cam_world, "T_cam_world")
        look = np.random.default_rng(rng.integers(2**63))
        self._touch(apply_randomization(self.world, self.randomization, look))
        camera = replace(
            self.config.camera,
            roll=self.randomization.camera_roll,
            look_at_noise=self.randomization.look_at_noise,
        )
        arrange = arrange_heap if self.config.kind == "heap" else arrange_clutter
        arrangement, T_cam_world, visibility = arrange(
            self, rng, target, self._resting, camera, T_cam_world
        )
        poses = {n: thing.placed.T_world_obj for n, thing in arrangement.objects.items()}
        self.state = SceneState(target, poses, T_cam_world, visibility)
        return self.state

    def present_objects(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Names of the objects that stand on the table, and their geoms."""
        names = tuple(self.state.T_world_obj) if self.state is not None else ()
        return names, np.array([self._geoms[name] for name in names], dtype=np.int64)

    def visibility(self, target: str, T_cam_world: np.ndarray, K: np.ndarray, size: int) -> float:
        """Visible fraction of an object in a square picture of ``size`` pixels."""
        geom = self._geoms[target]
        alone = self.graphics.silhouette(geom, T_cam_world, K, size, size)
        whole = np.count_nonzero(alone)
        if whole == 0:
            return 0.0
        rect = self.graphics.draw(T_cam_world, K, size, size, segment=True, groups=(MOVABLE,))
        return np.count_nonzero(self.graphics.geoms(rect) == geom) / whole

    def visibilities(
        self, names: Sequence[str], T_cam_world: np.ndarray, K: np.ndarray, size: int
    ) -> np.ndarray:
        """Visible fractions of several objects in one square picture of ``size`` pixels, (N,)."""
        rect = self.graphics.draw(T_cam_world, K, size, size, segment=True, groups=(MOVABLE,))
        seen = self.graphics.geoms(rect)
        fractions = []
        for name in names:
            geom = self._geoms[name]
            alone = self.graphics.silhouette(geom, T_cam_world, K, size, size)
            whole = int(np.count_nonzero(alone))
            fractions.append(np.count_nonzero(seen == geom) / whole if whole else 0.0)
        return np.array(fractions)

    def show(self, arrangement: Arrangement) -> None:
        """Moves the bodies to an arrangement and hides those that are not part of it."""
        self._show(arrangement)

    def close(self) -> None:
        """Frees the GL context. The scene stays usable; the next picture opens another."""
        self.graphics.close()

    def _touch(self, textures: list[int]) -> None:
        self.texture_versions[textures] += 1

    def _show(self, arrangement: Arrangement) -> None:
        self.arrangement = arrangement
        model, data = self.world.model, self.data
        things: dict[int, Thing] = {
            int(self._geoms[name]): thing for name, thing in arrangement.objects.items()
        }
        for i, thing in arrangement.shapes.items():
            things[int(self.world.shape_geoms[i])] = thing
        for k, (geom, address) in enumerate(self.world.qpos.items()):
            present = things.get(geom)
            model.geom_group[geom] = HIDDEN if present is None else MOVABLE
            model.geom_contype[geom] = model.geom_conaffinity[geom] = present is not None
            if present is None:
                data.qpos[address : address + 3] = (0.5 * k, 0.0, -3.0)  # parked
                data.qpos[address + 3 : address + 7] = (1.0, 0.0, 0.0, 0.0)
                continue
            if present.size is not None:
                _resize(model, geom, present.size)
            T = present.placed.T_world_obj
            data.qpos[address : address + 3] = T[:3, 3]
            mujoco.mju_mat2Quat(data.qpos[address + 3 : address + 7], T[:3, :3].ravel())
        data.qvel[:] = 0.0
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)


def _resize(model: mujoco.MjModel, geom: int, size: np.ndarray) -> None:
    """Gives a box, cylinder or sphere another size, and collision its new bounds."""
    model.geom_size[geom] = size
    kind = model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        half = size
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        half = np.array([size[0], size[0], size[1]])
    else:
        half = np.full(3, size[0])
    model.geom_aabb[geom, 3:] = half
    model.geom_rbound[geom] = np.linalg.norm(half)
