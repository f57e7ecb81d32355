"""The MuJoCo model of a scene: all objects, plain shapes, a table and a room.

It is compiled once. An episode moves bodies and changes sizes, colors, textures and lights in
place. Every object and shape is a free body whose collision geometry is its convex hull, so that
physics can check placements; rendering never steps the simulation.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import trimesh

from ...assets.object_model import ObjectModel
from .gl import mujoco

TABLE_HALF = (0.9, 0.7, 0.02)
"""Half sizes of the tabletop in meters; its upper side is z = 0."""
FLOOR_Z = -0.72
ROOM_HALF = 2.6
"""Half the side of the square room, meters."""
WALL_HALF = 1.6
"""Half the height of its walls, meters."""
NEAR, FAR = 0.03, 12.0
"""Clipping planes, meters."""


class GeomGroup(IntEnum):
    """MuJoCo geom groups, which select what is rendered."""

    ROOM = 0  # including the table
    MOVABLE = 1  # on the table
    HIDDEN = 3
    ISOLATED = 4  # rendered alone for its silhouette


SHAPE_KINDS = ("box", "box", "box", "box", "cylinder", "cylinder", "cylinder", "sphere", "sphere")
LIGHTS = 3
SHAPE_TEXTURES = 4
SHAPE_TEXTURE = 64
ROOM_TEXTURES = {"table": 512, "wall": 256, "floor": 256}
"""Sides of the textures of the room, pixels."""
_GEOM = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}


@dataclass(frozen=True, eq=False)
class World:
    """The compiled model and the ids of its parts.

    Attributes:
        model: the MuJoCo model.
        object_names: in the order of ``object_geoms``.
        object_geoms: geom of each object, (N,).
        shape_geoms: geom of each plain shape, (S,).
        materials: id of each material by name ("table", "wall", "floor", "shape3", "object:duck").
        textures: id of each randomized texture by name.
        shine: (specular, shininess) of each object's own material.
        qpos: address in ``qpos`` of the free joint of each movable geom.
    """

    model: mujoco.MjModel
    object_names: tuple[str, ...]
    object_geoms: np.ndarray
    shape_geoms: np.ndarray
    materials: dict[str, int]
    textures: dict[str, int]
    shine: dict[str, tuple[float, float]]
    qpos: dict[int, int]

    def geom(self, name: str) -> int:
        """Returns the geom of an object."""
        return int(self.object_geoms[self.object_names.index(name)])


def compile_world(objects: Mapping[str, ObjectModel]) -> World:
    """Compiles the model of ``objects`` and plain shapes on a table in a room."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.stat.extent, spec.stat.center = 1.0, (0.0, 0.0, 0.0)
    spec.visual.map.znear, spec.visual.map.zfar = NEAR, FAR
    spec.visual.map.shadowscale = 0.35  # of a light's cone, which covers the clutter
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 640, 480
    _add_room(spec)
    for i in range(LIGHTS):
        spec.worldbody.add_light(
            name=f"light{i}", type=mujoco.mjtLightType.mjLIGHT_SPOT, cutoff=60.0, exponent=1.0
        )
    for name, model in objects.items():
        _add_object(spec, name, model)
    for i in range(SHAPE_TEXTURES):
        texture = _add_texture(spec, f"shape{i}", SHAPE_TEXTURE, 6 * SHAPE_TEXTURE)
        texture.type = mujoco.mjtTexture.mjTEXTURE_CUBE
    for i, kind in enumerate(SHAPE_KINDS):
        _add_material(spec, f"shape{i}", f"shape{i % SHAPE_TEXTURES}")
        geom = _add_body(spec, f"shape{i}").add_geom(
            name=f"shape{i}", type=_GEOM[kind], size=(0.05, 0.05, 0.05), material=f"shape{i}"
        )
        _make_collidable(geom)
    model = spec.compile()
    object_geoms = np.array([model.geom(f"object:{name}").id for name in objects], np.int64)
    shape_geoms = np.array([model.geom(f"shape{i}").id for i in range(len(SHAPE_KINDS))], np.int64)
    moving = np.concatenate([object_geoms, shape_geoms])
    joints = model.body_jntadr[model.geom_bodyid[moving]]
    return World(
        model=model,
        object_names=tuple(objects),
        object_geoms=object_geoms,
        shape_geoms=shape_geoms,
        materials={model.material(i).name: i for i in range(model.nmat)},
        textures={
            model.texture(i).name: i
            for i in range(model.ntex)
            if not model.texture(i).name.startswith("object:")
        },
        shine={name: (m.specular, m.shininess) for name, m in objects.items()},
        qpos={int(g): int(a) for g, a in zip(moving, model.jnt_qposadr[joints], strict=True)},
    )


def _add_room(spec: mujoco.MjSpec) -> None:
    for name, size in ROOM_TEXTURES.items():
        _add_texture(spec, name, size, size)
        _add_material(spec, name, name)
    table = spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=TABLE_HALF,
        pos=(0.0, 0.0, -TABLE_HALF[2]),
        material="table",
        group=GeomGroup.ROOM,
    )
    _make_collidable(table)
    # Thin boxes rather than planes: MuJoCo renders planes two-sided and in many tiles.
    r = ROOM_HALF
    _add_sheet(spec, "floor", (r, r), np.array([0.0, 0.0, FLOOR_Z]), np.eye(3))
    for i in range(4):
        cos, sin = np.cos(i * np.pi / 2), np.sin(i * np.pi / 2)
        center = np.array([r * cos, r * sin, FLOOR_Z + WALL_HALF])
        # Columns: along the wall, up, into the room.
        axes = np.array([[sin, 0.0, -cos], [-cos, 0.0, -sin], [0.0, 1.0, 0.0]])
        _add_sheet(spec, f"wall{i}", (r, WALL_HALF), center, axes)


def _add_sheet(
    spec: mujoco.MjSpec,
    name: str,
    half: tuple[float, float],
    center: np.ndarray,
    axes: np.ndarray,
) -> None:
    """Adds a floor or wall without collisions; the third of its axes points inwards."""
    thickness = 0.01
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(*half, thickness),
        pos=center - thickness * axes[:, 2],
        quat=quat,
        material=name.rstrip("0123"),
        group=GeomGroup.ROOM,
        contype=0,
        conaffinity=0,
    )


def _add_object(spec: mujoco.MjSpec, name: str, model: ObjectModel) -> None:
    key = f"object:{name}"
    height, width = model.texture.shape[:2]
    _add_texture(spec, key, width, height, model.texture.tobytes())
    material = _add_material(spec, key, key)
    material.specular, material.shininess = model.specular, model.shininess
    faces, vertex, normals = corner_shading(model.vertices, model.faces)
    # An open mesh has no center of mass: that of its convex hull is used.
    closed = trimesh.Trimesh(model.vertices, model.faces).is_volume
    inertia = mujoco.mjtMeshInertia
    mesh = spec.add_mesh(
        name=key, inertia=inertia.mjMESH_INERTIA_EXACT if closed else inertia.mjMESH_INERTIA_CONVEX
    )
    mesh.uservert = model.vertices[vertex].ravel().tolist()
    mesh.userface = faces.ravel().tolist()
    mesh.usernormal = normals.ravel().tolist()
    # MuJoCo's v axis points down the image.
    mesh.usertexcoord = (model.uv[vertex] * (1, -1) + (0, 1)).ravel().tolist()
    geom = _add_body(spec, key).add_geom(
        name=key, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=key, material=key
    )
    _make_collidable(geom)


def corner_shading(
    vertices: np.ndarray, faces: np.ndarray, crease: float = np.deg2rad(40.0)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Computes vertex normals for smooth shading with sharp creases, splitting vertices.

    Texture seams, where vertices are duplicated, are shaded smoothly.

    Args:
        vertices: (V, 3); vertices at the same position count as one.
        faces: (F, 3).
        crease: angle in radians between faces above which their edge is sharp.

    Returns:
        Faces (F, 3) over N split vertices, the original vertex of each (N,), and its unit normal
        (N, 3).
    """
    triangles = vertices[faces]
    face_normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(face_normals, axis=1, keepdims=True)
    units = face_normals / np.maximum(areas, 1e-15)
    grid = np.round(vertices / (1e-6 * np.ptp(vertices, axis=0).max())).astype(np.int64)
    _, place = np.unique(grid, axis=0, return_inverse=True)
    # Pairs of corners at the same position.
    corner_place = place.ravel()[faces].ravel()  # (3 F,)
    order = np.argsort(corner_place, kind="stable")
    starts = np.searchsorted(corner_place[order], np.arange(place.max() + 2))
    counts = np.diff(starts)[corner_place]
    corners = np.repeat(np.arange(len(corner_place)), counts)
    within = np.arange(len(corners)) - np.repeat(np.cumsum(counts) - counts, counts)
    neighbors = order[np.repeat(starts[corner_place], counts) + within] // 3
    smooth = np.einsum("ij,ij->i", units[corners // 3], units[neighbors]) > np.cos(crease)
    normals = np.zeros((len(corner_place), 3))
    np.add.at(normals, corners[smooth], face_normals[neighbors[smooth]])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(lengths > 1e-15, normals / np.maximum(lengths, 1e-15), (0.0, 0.0, 1.0))
    key = np.column_stack([faces.ravel(), np.round(normals * 1e4).astype(np.int64)])
    _, first, split = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return split.reshape(faces.shape), faces.ravel()[first], normals[first]


def _add_texture(
    spec: mujoco.MjSpec, name: str, width: int, height: int, data: bytes | None = None
) -> mujoco.MjsTexture:
    """Adds a 2D texture, gray if ``data`` is None."""
    texture = spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        colorspace=mujoco.mjtColorSpace.mjCOLORSPACE_LINEAR,
        width=width,
        height=height,
        nchannel=3,
    )
    texture.data = data or bytes([128]) * (3 * width * height)
    return texture


def _add_material(spec: mujoco.MjSpec, name: str, texture: str) -> mujoco.MjsMaterial:
    material = spec.add_material(name=name)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture
    return material


def _add_body(spec: mujoco.MjSpec, name: str) -> mujoco.MjsBody:
    body = spec.worldbody.add_body(name=name)
    body.add_freejoint()
    return body


def _make_collidable(geom: mujoco.MjsGeom) -> None:
    geom.contype = geom.conaffinity = 1
    geom.condim = 6
    geom.friction = (0.9, 0.02, 0.005)
