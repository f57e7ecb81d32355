"""Reads image files: photographs, depth maps and masks, with OpenCV's colors.

Every image that a user gives is decoded here. Bits, palettes and transparency are as in
``cv2.imread``; what has no defined gray levels, such as floating point, is refused by name.
"""

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal
from warnings import catch_warnings, simplefilter

import numpy as np
from PIL import ExifTags, Image, ImageOps, UnidentifiedImageError

from .errors import InputError
from .files import write_atomically

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".bmp")
"""Of images that can be written."""

MAX_PIXELS = 120_000_000
"""Larger images are refused: two, and decoding one, take 13 bytes a pixel."""

_NOT_DECODED = (".heic", ".heif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".exr", ".hdr")
_AS_PNG = "write it with 8 or 16 bits a channel, such as a PNG"
_WHITE_IS_ZERO = 0
_UNDO: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    2: lambda upright: upright[:, ::-1],
    3: lambda upright: upright[::-1, ::-1],
    4: lambda upright: upright[::-1],
    5: lambda upright: upright.swapaxes(0, 1),
    6: lambda upright: np.rot90(upright),
    7: lambda upright: upright[::-1, ::-1].swapaxes(0, 1),
    8: lambda upright: np.rot90(upright, -1),
}
"""EXIF orientation -> from the upright image to its stored pixels."""


def read_image(path: Path, mode: Literal["RGB"] | None = "RGB") -> np.ndarray:
    """Decodes an image file; an EXIF orientation is ignored.

    Stored pixels are what masks, boxes and camera matrices of datasets refer to.

    Args:
        path: the file.
        mode: ``RGB``; None for the file's own bits and channels, such as 16-bit depth.

    Returns:
        (H, W, 3) uint8 for RGB; else the file's own type and channels.

    Raises:
        OSError: if the file cannot be opened.
        InputError: if it is not an image, truncated or damaged, too large, or without a defined
            conversion to RGB.
    """
    if mode == "RGB":
        return read_photograph(path, upright=False)[0]
    with _opened(path) as image:
        return _stored(*_decode(image), np.array(image))


def read_photograph(path: Path, *, upright: bool = True) -> tuple[np.ndarray, int]:
    """Decodes a photograph.

    Args:
        path: the file.
        upright: whether it is turned upright by its EXIF orientation, as ``cv2.imread`` does;
            False: the stored pixels.

    Returns:
        (H, W, 3) uint8 RGB, and the orientation, 1 to 8; 1 is upright.

    Raises:
        OSError, InputError: as `read_image`.
    """
    with _opened(path) as image:
        orientation, turned = _decode(image)
        if not upright:
            return _stored(orientation, turned, to_rgb(image, str(path))), orientation
        if turned or orientation == 1:
            return to_rgb(image, str(path)), orientation
        rotated = ImageOps.exif_transpose(image)
        rotated.format = image.format
        return to_rgb(rotated, str(path)), orientation


def read_mask(path: Path) -> np.ndarray:
    """Decodes a mask of any mode and bits: bool (H, W), whether a pixel is not black.

    Raises:
        OSError, InputError: as `read_image`.
    """
    with _opened(path) as image:
        orientation, turned = _decode(image)
        colored = image.mode in ("P", "PA", "LA", "La", "RGBA", "RGBa", "CMYK")
        pixels = to_rgb(image, str(path)) if colored else np.array(image)
        pixels = _stored(orientation, turned, pixels)
        return np.asarray(pixels.any(axis=2) if pixels.ndim == 3 else pixels != 0)


def read_image_size(path: Path) -> tuple[int, int]:
    """Reads height and width of the stored pixels from an image file's header.

    Raises:
        OSError, InputError: as `read_image`.
    """
    with _opened(path) as image:
        tags = getattr(image, "tag_v2", {})  # a TIFF's size is that after turning it
        width = tags.get(ExifTags.Base.ImageWidth, image.width)
        return int(tags.get(ExifTags.Base.ImageLength, image.height)), int(width)


def to_rgb(image: Image.Image, name: str) -> np.ndarray:
    """Converts a decoded image of any mode to (H, W, 3) uint8 as OpenCV does.

    16 bits are divided by 256; transparency is dropped.

    Args:
        image: from Pillow, whose own conversion clips 16 bits to 255.
        name: of the image, for errors.

    Raises:
        InputError: if the mode has no defined conversion.
    """
    mode = image.mode
    if mode.startswith("I;16") or (mode == "I" and image.format in ("PNG", "PPM")):
        tags = getattr(image, "tag_v2", {})
        bits = int(tags.get(ExifTags.Base.BitsPerSample, (16,))[0])
        gray = (np.asarray(image).astype(np.uint16) >> (bits - 8)).astype(np.uint8)
        if tags.get(ExifTags.Base.PhotometricInterpretation) == _WHITE_IS_ZERO:
            gray = 255 - gray  # Pillow inverts 8 bits only
        return np.repeat(gray[..., None], 3, axis=2)
    if mode in ("F", "I"):
        kind = "floating-point numbers" if mode == "F" else "32-bit integers"
        raise InputError(f"{name} holds {kind}, whose white is not defined: {_AS_PNG}")
    if mode in ("PA", "RGBa", "La"):
        image = image.convert("RGBA")
    image.info.pop("transparency", None)  # Pillow warns where it drops it
    try:
        return np.array(image if image.mode == "RGB" else image.convert("RGB"))
    except ValueError as error:
        raise InputError(f"{name} has colors of mode {mode}, which are not read: {_AS_PNG}") from (
            error
        )


def check_image_suffix(path: Path, name: str) -> None:
    """Raises InputError if an image cannot be written to ``path``, the option ``name``."""
    if path.suffix.lower() not in IMAGE_SUFFIXES:
        raise InputError(f"{name} must end in {', '.join(IMAGE_SUFFIXES)}, got {path}")


def write_image(path: Path, image: np.ndarray) -> None:
    """Writes an image (H, W, 3) uint8 RGB atomically, as its suffix says; see `IMAGE_SUFFIXES`."""
    buffer = io.BytesIO()
    kind = Image.registered_extensions()[path.suffix.lower()]
    Image.fromarray(image).save(
        buffer, kind, compress_level=1, quality=90
    )  # PNGs faster, JPEGs finer
    write_atomically(path, buffer.getvalue())


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Opens an image file; what Pillow raises while it is open becomes one of two errors."""
    try:
        with catch_warnings():  # what is too large is refused here
            simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(path)
        with image:
            _check_header(image, path)
            yield image
    except (InputError, MemoryError):
        raise
    except UnidentifiedImageError as error:
        hint = ""
        if Path(path).suffix.lower() in _NOT_DECODED:
            hint = f"; {Path(path).suffix} is not read: convert it to PNG or JPEG"
        raise InputError(f"{path} is not an image file (PNG, JPEG, ...){hint}") from error
    except Image.DecompressionBombError as error:
        raise _too_large(path) from error
    except Exception as error:  # decoders raise all kinds of errors
        if getattr(error, "filename", None):  # it could not be opened
            raise
        raise InputError(f"{path} is a truncated or damaged image ({error})") from error


def _check_header(image: Image.Image, path: Path) -> None:
    if image.width * image.height > MAX_PIXELS:
        raise _too_large(path, f" ({image.width}x{image.height} pixels)")
    reduced = getattr(image, "tag_v2", {}).get(ExifTags.Base.NewSubfileType, 0) & 1
    if reduced and image.format == "TIFF":
        raise InputError(f"{path} is a raw photograph that begins with a preview: {_AS_PNG}")


def _too_large(path: Path, size: str = "") -> InputError:
    return InputError(
        f"{path} is too large{size}; at most {MAX_PIXELS // 10**6} megapixels are read: scale the "
        "image down, and fx, fy, cx and cy with it"
    )


def _decode(image: Image.Image) -> tuple[int, bool]:
    """Decodes an image; returns its EXIF orientation and whether Pillow has turned it upright.

    It turns TIFFs, and then drops their tag. The EXIF data of a PNG may come after its pixels.
    """
    tag = ExifTags.Base.Orientation
    before = getattr(image, "tag_v2", {}).get(tag)
    image.load()
    try:
        after = image.getexif().get(tag)
    except Exception:  # damaged EXIF data say nothing of the pixels
        after = None
    orientation = before or after
    turned = before is not None and after is None
    return (orientation, turned) if orientation in _UNDO else (1, False)


def _stored(orientation: int, turned: bool, pixels: np.ndarray) -> np.ndarray:
    """Undoes that Pillow has turned an image."""
    return np.ascontiguousarray(_UNDO[orientation](pixels)) if turned else pixels
