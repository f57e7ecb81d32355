"""Files that a mesh names: materials and textures, found as their writers meant them.

Meshes come from other machines: names have backslashes, other letter case, percent signs, or the
folder of that machine.
"""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

import numpy as np
from PIL import Image

from ...core.errors import InputError
from ...core.images import to_rgb


def decode_text(data: bytes) -> str:
    """Decodes UTF-8 or UTF-16 with or without a byte order mark; other text is Latin-1."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def find_linked(name: str, mesh: Path) -> Path | None:
    """Finds the file that a mesh names, relative to the mesh; None if there is none.

    A name with folders is looked for there, then beside the mesh; upper and lower case are told
    apart only where both exist.
    """
    for candidate in _candidates(name):
        found = _look_up(mesh.parent, candidate)
        if found is not None:
            return found
    return None


def require_linked(name: str, mesh: Path, what: str, remedy: str) -> Path:
    """As `find_linked`.

    Args:
        name: as the mesh writes it.
        mesh: the file that names it.
        what: for the message, such as "texture".
        remedy: what else can be done than to add the file, for the message.

    Raises:
        InputError: if there is no such file.
    """
    found = find_linked(name, mesh)
    if found is None:
        raise InputError(
            f"{mesh} names the {what} {name!r}, which is not in {mesh.parent}: put the file there, "
            f"or {remedy}"
        )
    return found


def read_texture(source: Path | bytes, name: str) -> np.ndarray:
    """Decodes a texture to RGBA (H, W, 4) uint8, rows as stored.

    Args:
        source: the file, or its content.
        name: for messages.

    Raises:
        InputError: if it is not an image that Pillow reads, or truncated.
    """
    try:
        with Image.open(source if isinstance(source, Path) else BytesIO(source)) as image:
            return _rgba(image, name)
    except InputError:
        raise
    except Exception as error:  # decoders raise all kinds of errors
        raise InputError(
            f"{name} is not an image that can be read (PNG, JPEG, ...), or truncated"
        ) from error


def _rgba(image: Image.Image, name: str) -> np.ndarray:
    """Eight bits a channel; of more bits, alpha is 255."""
    if image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info:
        return np.array(image.convert("RGBA"))
    rgb = to_rgb(image, name)
    return np.dstack([rgb, np.full(rgb.shape[:2], 255, np.uint8)])


def _candidates(name: str) -> Iterator[PurePosixPath]:
    """The ways to read a name, the most literal first."""
    stripped = name.strip().strip("\"'")
    forms = [stripped, stripped.replace("\\", "/")]
    forms += [unquote(form).removeprefix("file://") for form in forms]
    for form in dict.fromkeys(forms):
        yield PurePosixPath(form)
    for form in dict.fromkeys(forms):
        yield PurePosixPath(PurePosixPath(form).name)


def _look_up(folder: Path, name: PurePosixPath) -> Path | None:
    """The file below a folder, exactly or else in another letter case."""
    place = folder / name
    try:
        if place.is_file():
            return place
        place = Path(name.anchor) if name.is_absolute() else folder
        for step in name.parts[1:] if name.is_absolute() else name.parts:
            if step != ".." and not (place / step).exists():
                entries = sorted(place.iterdir())
                step = next(e.name for e in entries if e.name.casefold() == step.casefold())
            place /= step
    except (OSError, StopIteration, ValueError):  # no such folder, or not a name at all
        return None
    return place if place.is_file() else None
