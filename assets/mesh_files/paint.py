"""The colors of a part of a mesh, for every way in which files store them."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from trimesh.visual.color import linear_to_srgb, srgb_to_linear

from ...core.errors import InputError
from ...core.validation import is_number
from ..texture import sample_texture

DEFAULT_COLOR = np.array([0.62, 0.62, 0.62])
"""Of a mesh without colors, RGB in [0, 1]."""

Wrap = Literal["repeat", "clamp", "mirror"]
"""What lies outside of a texture."""

_MOST_TRANSPARENT = 0.01
"""Share of a part's surface that may be transparent: leaks of the border texels."""


@dataclass(eq=False)
class Paint:
    """A color for every place of a surface: factor x colors x texture.

    Attributes:
        factor: (4,) RGBA of the whole part, in [0, 1].
        colors: RGBA in [0, 1], (V, 4) of the vertices or, with ``of_faces``, (F, 4).
        texture: (H, W, 4) uint8 sRGB with opacity, row 0 at the top.
        uv: (V, 2) texture coordinates, v up.
        wrap: outside of the texture, in u and v.
        linear: factor and colors are linear light, as glTF has them, and so is the product.
        cutoff: opacity below which the surface is not seen; None: the opacity means nothing.
        glow: light that is added, where ``linear``.
        kind: what the colors come from, in words; empty: the file has none.
        source: the file and material, for messages.
    """

    factor: np.ndarray = field(default_factory=lambda: np.ones(4))
    colors: np.ndarray | None = None
    of_faces: bool = False
    texture: np.ndarray | None = None
    uv: np.ndarray | None = None
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    linear: bool = False
    cutoff: float | None = None
    glow: "Paint | None" = None
    kind: str = ""
    source: str = ""

    def check(self, vertices: int, faces: int) -> None:
        """Checks that these are finite colors for so many vertices and faces.

        Raises:
            InputError: if they are not.
        """
        shapes = {"factor": (4,), "colors": (faces if self.of_faces else vertices, 4)}
        for name, shape in (shapes | {"uv": (vertices, 2)}).items():
            numbers = getattr(self, name)
            if numbers is None:
                continue
            if numbers.shape != shape or not np.isfinite(numbers).all():
                what = "texture coordinates" if name == "uv" else "colors"
                raise InputError(
                    f"{self.source} has {what} that are not finite, or too few: shape "
                    f"{numbers.shape}, not {shape}"
                )
        if self.cutoff is not None and not is_number(self.cutoff):
            raise InputError(f"{self.source}: alphaCutoff is no number: {self.cutoff!r:.80}")
        if self.glow is not None:
            self.glow.check(vertices, faces)

    def rgb(self, faces: np.ndarray, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Returns sRGB colors (N, 3) in [0, 1].

        Args:
            faces: (F, 3) of the mesh.
            face: (N,) the faces to look at.
            weights: (N, 3) barycentric.

        Raises:
            InputError: if more than a percent of these places is transparent.
        """
        rgba = self._light(faces, face, weights)
        if self.cutoff is not None:
            share = float((rgba[:, 3] < self.cutoff).mean()) if len(rgba) else 0.0
            if share > _MOST_TRANSPARENT:
                raise InputError(
                    f"{self.source} is transparent on {100 * share:.0f} % of its surface, but "
                    "objects are rendered opaque: cut these faces away, or make the material opaque"
                )
        rgb = np.clip(rgba[:, :3], 0.0, 1.0)
        return np.asarray(linear_to_srgb(rgb)) if self.linear else rgb

    def _light(self, faces: np.ndarray, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """RGBA (N, 4), linear light if ``linear``."""
        corners = faces[face]
        rgba = np.tile(self.factor, (len(face), 1))
        if self.colors is not None and self.of_faces:
            rgba *= self.colors[face]
        elif self.colors is not None:
            rgba *= np.einsum("nk,nki->ni", weights, self.colors[corners])
        if self.texture is not None:
            assert self.uv is not None
            uv = np.einsum("nk,nki->ni", weights, self.uv[corners])
            texels = sample_texture(self.texture, self._wrapped(uv))
            if self.linear:
                texels[:, :3] = srgb_to_linear(texels[:, :3])
            rgba *= texels
        if self.glow is not None:
            rgba[:, :3] += self.glow._light(faces, face, weights)[:, :3]
        return rgba

    def _wrapped(self, uv: np.ndarray) -> np.ndarray:
        """Texture coordinates for a texture that repeats."""
        assert self.texture is not None
        uv = uv.copy()
        for axis, size in ((0, self.texture.shape[1]), (1, self.texture.shape[0])):
            if self.wrap[axis] == "mirror":
                uv[:, axis] = 1.0 - np.abs(uv[:, axis] % 2.0 - 1.0)
            if self.wrap[axis] != "repeat":  # a mirrored border meets itself
                uv[:, axis] = np.clip(uv[:, axis], 0.5 / size, 1.0 - 0.5 / size)
        return uv


def plain_paint(rgb: np.ndarray, kind: str, source: str) -> Paint:
    """One color, RGB in [0, 1], everywhere."""
    return Paint(factor=np.append(rgb, 1.0), kind=kind, source=source)


def unpainted(source: str) -> Paint:
    """The paint of a mesh without colors."""
    return plain_paint(DEFAULT_COLOR, "", source)


def unit_range(values: np.ndarray, source: str) -> np.ndarray:
    """Returns colors as RGBA (N, 4) in [0, 1], whatever range a file without a standard has.

    The range is that of the type (uint8, uint16); floats and wider integers end at 1, 255 or 65535,
    the first that holds them all, and a uint16 that ends at 255 was written from bytes.

    Args:
        values: (N, 3) or (N, 4), as stored.
        source: the file, for messages.

    Raises:
        InputError: if colors are negative, not finite, or of no such range.
    """
    array = np.asarray(values)
    numbers = array.astype(np.float64)
    low, high = (numbers[:, :3].min(), numbers[:, :3].max()) if numbers.size else (0.0, 0.0)
    if not np.isfinite(numbers).all() or low < 0 or high > 65535.5:
        raise InputError(
            f"{source} has colors from {low:g} to {high:g}; they must be 0 to 1, or 0 to 255"
        )
    if array.dtype == np.uint8:
        top = 255.0
    elif array.dtype.kind in "iu":
        top = 255.0 if high <= 255 else 65535.0
    else:
        top = 1.0 if high <= 1.001 else 255.0 if high <= 255.5 else 65535.0
    rgba = np.ones((len(numbers), 4))
    rgba[:, :3] = np.clip(numbers[:, :3] / top, 0.0, 1.0)
    return rgba


def all_white(rgba: np.ndarray) -> bool:
    """Whether colors say nothing: writers add white ones to any mesh."""
    return bool((rgba[:, :3] > 0.999).all())
