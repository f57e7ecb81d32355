"""The scene of an episode: a table with a target, clutter and a reference camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import check_rigid, transform
from ...core.validation import require_range, require_within
from .arrangement import Arrangement, Prop, probe_camera
from .camera import CameraRange
from .gl import mujoco
from .graphics import Graphics
from .placement import stable_poses
from .randomization import Randomization, apply_randomization, neutral_look
from .scene_kinds import SCENE_KINDS
from .world import SHAPE_KINDS, GeomGroup, World, compile_world


@dataclass(frozen=True)
class SceneConfig:
    """Configuration of a scene.

    Attributes:
        kind: a name of :data:`~.scene_kinds.SCENE_KINDS`, where all are described.
        clutter_objects: minimum and maximum number of other objects; None: the kind's own.
        plain_shapes: minimum and maximum number of boxes, cylinders and spheres; None: the kind's.
        upright_probability: of the target.
        clutter_upright_probability: of each other object.
        camera: range of the reference camera around the target; roll and look-at noise are those of
            the randomization.
    """

    kind: str = "linemod"
    clutter_objects: tuple[int, int] | None = None
    plain_shapes: tuple[int, int] | None = None
    upright_probability: float = 1.0
    clutter_upright_probability: float = 0.7
    camera: CameraRange = field(default_factory=CameraRange)

    def __post_init__(self) -> None:
        if self.kind not in SCENE_KINDS:
            raise InputError(f"scene kind must be one of {tuple(SCENE_KINDS)}, got {self.kind!r}")
        if self.clutter_objects is not None:
            require_range(self, 0, np.inf, "clutter_objects")
        if self.plain_shapes is not None:
            require_range(self, 0, len(SHAPE_KINDS), "plain_shapes")
        require_within(self, 0, 1, "upright_probability", "clutter_upright_probability")

    @property
    def object_count(self) -> tuple[int, int]:
        """Minimum and maximum number of other objects."""
        return self.clutter_objects or SCENE_KINDS[self.kind].object_count

    @property
    def shape_count(self) -> tuple[int, int]:
        """Minimum and maximum number of plain shapes."""
        return self.plain_shapes or SCENE_KINDS[self.kind].shape_count


@dataclass(frozen=True, eq=False)
class SceneState:
    """Ground truth of a scene.

    Attributes:
        target: name of the target object.
        T_world_obj: pose of every object on the table, target included, (4, 4) each.
        T_cam_world: the reference camera, (4, 4).
        visibility: visible fraction of the target in the reference view.
    """

    target: str
    T_world_obj: dict[str, np.ndarray]
    T_cam_world: np.ndarray
    visibility: float


@dataclass(frozen=True, eq=False)
class ArrangementRequest:
    """Input of a function that arranges scenes.

    It returns the arrangement, T_cam_world (4, 4) of the reference camera, and the visible fraction
    of the target in it.

    Attributes:
        scene: measures the visibility of arrangements.
        rng: source of all randomness.
        target: name of the target, which is part of every arrangement.
        cameras: range of the reference camera.
        T_cam_world: the reference camera, (4, 4); None: it is sampled.
    """

    scene: Scene
    rng: np.random.Generator
    target: str
    cameras: CameraRange
    T_cam_world: np.ndarray | None


class Scene:
    """Objects on a table. Compiled once; a reset only moves, recolors and relights.

    Args:
        objects: by name; any of them can be the target.
        config: what is on the table.
        randomization: domain randomization at each reset.

    Attributes:
        arrangement: the current one.
        stable_poses: of each object, upright first.

    Raises:
        InputError: if there are no objects, or one was stored without its mesh.
    """

    def __init__(
        self,
        objects: Mapping[str, ObjectModel],
        config: SceneConfig | None = None,
        randomization: Randomization | None = None,
    ) -> None:
        if not objects:
            raise InputError("a scene needs at least one object, got none")
        for name, model in objects.items():
            if not model.has_surface:
                raise InputError(
                    f"{name} cannot be drawn: it was stored without its mesh, as in weights for "
                    "objects whose meshes must not be shared. Name its mesh file (--objects, "
                    "objects=)"
                )
        self.objects = dict(objects)
        self.config = config or SceneConfig()
        self.randomization = randomization or Randomization()
        self.world: World = compile_world(self.objects)
        self.data = mujoco.MjData(self.world.model)
        self.texture_versions = np.zeros(self.world.model.ntex, dtype=np.int64)
        self.graphics = Graphics(self.world, self.data, self.texture_versions)
        self.state: SceneState | None = None
        self.stable_poses = {name: stable_poses(model) for name, model in self.objects.items()}
        self.texture_versions[neutral_look(self.world)] += 1
        self.show(Arrangement({}, {}))

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of all objects."""
        return self.world.object_names

    @property
    def shadows(self) -> bool:
        """Whether an active light casts shadows."""
        model = self.world.model
        return bool(np.any(model.light_castshadow & model.light_active))

    def reset(
        self, rng: np.random.Generator, target: str, T_cam_world: np.ndarray | None = None
    ) -> SceneState:
        """Sets up a new episode.

        Args:
            rng: the same generator state gives the same scene.
            target: name of the target object.
            T_cam_world: the reference camera, (4, 4); sampled from ``config.camera`` if None.

        Raises:
            InputError: if the target is unknown or the camera is not a rigid transform.
        """
        if target not in self.objects:
            raise InputError(f"target must be one of {self.object_names}, got {target!r}")
        if T_cam_world is not None:
            T_cam_world = check_rigid(T_cam_world, "T_cam_world")
        appearance_rng = np.random.default_rng(rng.integers(2**63))
        changed = apply_randomization(self.world, self.randomization, appearance_rng)
        self.texture_versions[changed] += 1
        cameras = replace(
            self.config.camera,
            roll=self.randomization.camera_roll,
            look_at_noise=self.randomization.look_at_noise,
        )
        arrange = SCENE_KINDS[self.config.kind].load_arranger()
        request = ArrangementRequest(self, rng, target, cameras, T_cam_world)
        arrangement, T_cam_world, visibility = arrange(request)
        self.show(arrangement)
        poses = {name: prop.placed.T_world_obj for name, prop in arrangement.objects.items()}
        self.state = SceneState(target, poses, T_cam_world, visibility)
        return self.state

    def present_objects(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Returns the names of the objects on the table, and their geoms."""
        names = tuple(self.state.T_world_obj) if self.state is not None else ()
        return names, np.array([self.world.geom(name) for name in names], dtype=np.int64)

    def surface(self, names: Sequence[str]) -> np.ndarray:
        """Returns the concatenated vertices of objects on the table, (N, 3) meters, world."""
        placed = self.arrangement.objects
        return np.concatenate(
            [transform(placed[n].placed.T_world_obj, self.objects[n].vertices) for n in names]
        )

    def visibility(
        self, names: Sequence[str], T_cam_world: np.ndarray, K: np.ndarray, height: int, width: int
    ) -> np.ndarray:
        """Returns the visible fractions of N objects in an image, (N,).

        Each is the number of visible pixels over that of the unoccluded silhouette within the
        image, or 0 if that is empty.
        """
        rect = self.graphics.draw(
            T_cam_world, K, height, width, segment=True, groups=(GeomGroup.MOVABLE,)
        )
        seen = self.graphics.geoms(rect)
        fractions = []
        for geom in (self.world.geom(name) for name in names):
            alone = self.graphics.silhouette(geom, T_cam_world, K, height, width)
            visible, total = int(np.count_nonzero(seen == geom)), int(np.count_nonzero(alone))
            fractions.append(visible / max(1, total))
        return np.array(fractions)

    def probe_visibility(
        self, names: Sequence[str], T_cam_world: np.ndarray, size: int = 96
    ) -> np.ndarray:
        """Returns visible fractions (N,) in LineMOD's camera, measured in a small square crop."""
        K = probe_camera(transform(T_cam_world, self.surface(names)), size)
        if K is None:
            return np.zeros(len(names))
        return self.visibility(names, T_cam_world, K, size, size)

    def show(self, arrangement: Arrangement) -> None:
        """Moves the bodies to an arrangement and hides all others."""
        self.arrangement = arrangement
        model, data = self.world.model, self.data
        props: dict[int, Prop] = {
            self.world.geom(name): prop for name, prop in arrangement.objects.items()
        }
        for i, prop in arrangement.shapes.items():
            props[int(self.world.shape_geoms[i])] = prop
        for k, (geom, address) in enumerate(self.world.qpos.items()):
            present = props.get(geom)
            model.geom_group[geom] = GeomGroup.HIDDEN if present is None else GeomGroup.MOVABLE
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
    """Resizes a box, cylinder or sphere and its collision bounds."""
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
