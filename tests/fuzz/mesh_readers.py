"""Readers of meshes: PLY, OBJ with its materials, STL, GLB."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from helpers.mesh_files import CORNERS, FACES, png, write_glb, write_obj, write_ply
from two_view_pose.assets.mesh_files import read_parts

from .judge import Reader, require

_COLORS = ("uchar red", "uchar green", "uchar blue")
_UV = ("float s", "float t")


def _read(name: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        for part in read_parts(folder / name):
            mesh = part.mesh
            require(np.isfinite(mesh.vertices), "vertices")
            require(mesh.vertices.ndim == 2 and mesh.vertices.shape[1] == 3, "vertices")
            require((mesh.faces >= 0) & (mesh.faces < len(mesh.vertices)), "faces")
            face = np.arange(len(mesh.faces))
            colors = part.paint.rgb(mesh.faces, face, np.full((len(face), 3), 1 / 3))
            require(colors.shape == (len(face), 3), f"colors {colors.shape}")
            require((colors >= 0) & (colors <= 1), "colors are not 0 to 1")

    return read


def _mesh() -> trimesh.Trimesh:
    return trimesh.Trimesh(CORNERS, FACES, process=False)


def _write_ply(folder: Path) -> None:
    write_ply(folder / "mesh.ply", _COLORS, "200 40 40")


def _write_textured_ply(folder: Path) -> None:
    (folder / "paint.png").write_bytes(png((200, 40, 40)))
    write_ply(folder / "mesh.ply", _UV, "0.1 0.9", comment="comment TextureFile paint.png")


def _write_binary_ply(folder: Path) -> None:
    mesh = _mesh()
    mesh.visual.vertex_colors = np.tile([200, 40, 40, 255], (4, 1))
    (folder / "mesh.ply").write_bytes(trimesh.exchange.ply.export_ply(mesh))


def _write_obj(folder: Path) -> None:
    (folder / "paint.png").write_bytes(png((200, 40, 40)))
    (folder / "mesh.mtl").write_text("newmtl a\nKd 0.5 0.2 0.1\nmap_Kd -s 1 1 1 paint.png\n")
    write_obj(folder / "mesh.obj", lines="mtllib mesh.mtl\nusemtl a")


def _write_stl(folder: Path) -> None:
    (folder / "mesh.stl").write_bytes(trimesh.exchange.stl.export_stl(_mesh()))


def _write_text_stl(folder: Path) -> None:
    (folder / "mesh.stl").write_text(trimesh.exchange.stl.export_stl_ascii(_mesh()))


def _write_glb(folder: Path) -> None:
    uv = np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9], [0.9, 0.9]], dtype=np.float32)
    color = {"baseColorTexture": {"index": 0}, "baseColorFactor": [1, 0.5, 0.5, 1]}
    material = {"pbrMetallicRoughness": color, "alphaMode": "MASK"}
    attributes = {"TEXCOORD_0": uv, "COLOR_0": np.tile(np.uint8([200, 100, 50, 255]), (4, 1))}
    write_glb(folder / "mesh.glb", material, attributes, (png((200, 40, 40)),))


MESHES = {
    "ply": Reader(_write_ply, ("*.ply",), _read("mesh.ply")),
    "ply-texture": Reader(_write_textured_ply, ("*",), _read("mesh.ply")),
    "ply-binary": Reader(_write_binary_ply, ("*.ply",), _read("mesh.ply")),
    "obj": Reader(_write_obj, ("*",), _read("mesh.obj")),
    "stl": Reader(_write_stl, ("*.stl",), _read("mesh.stl")),
    "stl-text": Reader(_write_text_stl, ("*.stl",), _read("mesh.stl")),
    "glb": Reader(_write_glb, ("*.glb",), _read("mesh.glb")),
}
