"""Materials of glTF: base color and emission, with their textures, in linear light.

Khronos Group, "glTF 2.0 Specification", sections 3.9 (materials) and 3.8 (textures), and the
extensions KHR_texture_transform, KHR_materials_pbrSpecularGlossiness, EXT_texture_webp and
EXT_texture_avif.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError
from .linked_files import read_texture
from .paint import Paint, Wrap, unpainted

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
_BLEND_CUTOFF = 0.5
"""Opacity below which a blended surface counts as transparent."""


class GltfPainter:
    """Makes the paint of primitives; textures are read when the first of them needs one."""

    def __init__(
        self,
        path: Path,
        header: Mapping[str, Any],
        content: Callable[[dict[str, Any], str], bytes | Path],
    ):
        """Initializes without reading any image.

        Args:
            path: the file, for messages.
            header: its JSON.
            content: returns the bytes or the file of an image, which the second argument names.
        """
        self._path, self._header, self._content = path, header, content
        self._images: dict[int, np.ndarray] = {}

    def paint(self, material: int | None, attributes: Mapping[str, np.ndarray]) -> Paint:
        """Returns the paint of a primitive.

        Args:
            material: its index; None without one.
            attributes: COLOR_0 and TEXCOORD_n as numbers; without ``normalized``, as stored.
        """
        colors = attributes.get("COLOR_0")
        if colors is not None:
            colors = _rgba(np.clip(colors, 0.0, 1.0))
        if material is None:
            return self._bare(colors)
        entry = self._header["materials"][material]
        source = f"{self._path}, material {entry.get('name', material)!r}"
        color, texture = _base_color(entry)
        paint = Paint(factor=color, colors=colors, linear=True, source=source)
        self._add_texture(paint, texture, attributes)
        paint.kind = "texture" if texture else "materials" if colors is None else "colors of the "
        paint.kind += "vertices" if paint.kind.endswith("the ") else ""
        if entry.get("alphaMode", "OPAQUE") == "MASK":
            paint.cutoff = entry.get("alphaCutoff", 0.5)
        elif entry.get("alphaMode") == "BLEND":
            paint.cutoff = _BLEND_CUTOFF
        paint.glow = self._glow(entry, attributes, source)
        return paint

    def _bare(self, colors: np.ndarray | None) -> Paint:
        """The paint without a material."""
        source = str(self._path)
        if colors is None:
            return unpainted(source)
        # trimesh writes the colors of a mesh as they are, where glTF has linear light.
        linear = "trimesh" not in self._header.get("asset", {}).get("generator", "")
        return Paint(colors=colors, linear=linear, kind="colors of the vertices", source=source)

    def _glow(
        self, entry: Mapping[str, Any], attributes: Mapping[str, np.ndarray], source: str
    ) -> Paint | None:
        """The light that a material emits; None without any."""
        light = np.array(entry.get("emissiveFactor", (0.0, 0.0, 0.0)), dtype=np.float64)
        if not light.any():
            return None
        glow = Paint(factor=np.append(light, 1.0), linear=True, source=source)
        self._add_texture(glow, entry.get("emissiveTexture"), attributes)
        return glow

    def _add_texture(
        self, paint: Paint, info: dict[str, Any] | None, attributes: Mapping[str, np.ndarray]
    ) -> None:
        """Sets texture, coordinates and wrapping from a textureInfo object."""
        if info is None:
            return
        transform = info.get("extensions", {}).get("KHR_texture_transform", {})
        name = f"TEXCOORD_{transform.get('texCoord', info.get('texCoord', 0))}"
        if name not in attributes:
            raise InputError(f"{paint.source} has a texture, but its mesh has no {name}")
        texture = self._header["textures"][info["index"]]
        sampler = self._header["samplers"][texture["sampler"]] if "sampler" in texture else {}
        u, v = (_WRAPS[sampler.get(key, 10497)] for key in ("wrapS", "wrapT"))
        uv = _transformed(attributes[name], transform)
        paint.uv = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)
        paint.wrap = (u, v)
        paint.texture = self._image(texture, paint.source)

    def _image(self, texture: Mapping[str, Any], source: str) -> np.ndarray:
        """The pixels (H, W, 4) of a texture object."""
        extensions = texture.get("extensions", {})
        index = texture.get("source")
        for extension in ("EXT_texture_webp", "EXT_texture_avif"):
            index = extensions.get(extension, {}).get("source", index)
        if index is None:
            named = ", ".join(extensions) or "no image"
            raise InputError(
                f"{source} has a texture of an unsupported type ({named}): export PNG or JPEG"
            )
        if index not in self._images:
            image = self._header["images"][index]
            name = image.get("name") or image.get("mimeType") or ""
            if not image.get("uri", "data:").startswith("data:"):
                name = image["uri"]
            content = self._content(image, "texture")
            self._images[index] = read_texture(content, f"the texture {name!r} of {source}")
        return self._images[index]


def _base_color(entry: Mapping[str, Any]) -> tuple[np.ndarray, dict[str, Any] | None]:
    """The factor (4,) and textureInfo of a material's color.

    Of specular-glossiness it is the diffuse color; metals, which have none, show their specular.
    """
    glossy = entry.get("extensions", {}).get(_SPECULAR_GLOSSINESS)
    if glossy is None:
        rough = entry.get("pbrMetallicRoughness", {})
        factor = np.array(rough.get("baseColorFactor", (1.0,) * 4), dtype=np.float64)
        return factor, rough.get("baseColorTexture")
    diffuse = np.array(glossy.get("diffuseFactor", (1.0,) * 4), dtype=np.float64)
    if diffuse[:3].any():
        return diffuse, glossy.get("diffuseTexture")
    specular = np.append(glossy.get("specularFactor", (1.0,) * 3), diffuse[3])
    return specular, glossy.get("specularGlossinessTexture")


def _transformed(uv: np.ndarray, transform: Mapping[str, Any]) -> np.ndarray:
    """KHR_texture_transform of coordinates (N, 2), v down: scale, then rotation, then offset."""
    angle = transform.get("rotation", 0.0)
    c, s = np.cos(angle), np.sin(angle)
    scaled = uv * transform.get("scale", (1.0, 1.0))
    # Counter-clockwise as seen, with v down.
    return np.asarray(scaled @ np.array([[c, -s], [s, c]]) + transform.get("offset", (0.0, 0.0)))


def _rgba(colors: np.ndarray) -> np.ndarray:
    """Colors (N, 3) or (N, 4) with opacity."""
    if colors.shape[1] == 4:
        return colors
    return np.column_stack([colors, np.ones(len(colors))])
