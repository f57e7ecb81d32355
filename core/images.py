"""Reads image files."""

from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image

from .errors import InputError


def read_image(path: Path, mode: Literal["RGB", "L"] | None = "RGB") -> np.ndarray:
    """Decodes an image file.

    Args:
        path: the file.
        mode: ``RGB``; ``L`` for gray; None for the file's own, such as 16-bit depth.

    Returns:
        uint8, (H, W, 3) for RGB and (H, W) for gray; else the file's own type and channels.

    Raises:
        OSError: if the file cannot be opened.
        InputError: if it is not an image, or truncated or corrupted.
    """
    try:
        with Image.open(path) as image:
            return np.array(image if mode in (None, image.mode) else image.convert(mode))
    except Exception as error:  # decoders raise all kinds of errors
        if getattr(error, "errno", None):
            raise
        raise InputError(f"{path} is not an image file (PNG, JPEG, ...) or truncated") from error


def read_image_size(path: Path) -> tuple[int, int]:
    """Reads height and width from an image file's header.

    Raises:
        OSError: if the file cannot be opened, or is not an image.
    """
    with Image.open(path) as image:
        return image.height, image.width
