"""Reading image files: one decoder for all."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image

from .errors import InputError


def read_image(path: Path, mode: Literal["RGB", "L"] | None = "RGB") -> np.ndarray:
    """Decodes an image file.

    Args:
        path: the file.
        mode: ``RGB``; ``L`` for gray; None for what the file holds, such as depth of 16 bits.

    Returns:
        uint8, (H, W, 3) for RGB and (H, W) for gray; else the file's own type and channels.

    Raises:
        OSError: if the file cannot be opened.
        InputError: if it is not an image, or truncated or damaged.
    """
    try:
        with Image.open(path) as image:
            return np.array(image if mode in (None, image.mode) else image.convert(mode))
    except Exception as error:  # readers of broken files fail in every way there is
        if getattr(error, "errno", None):
            raise
        what = "is not a picture file (PNG, JPEG, ...), or it is truncated"
        raise InputError(f"image {path} {what}") from error


def read_image_size(path: Path) -> tuple[int, int]:
    """Height and width that an image file's header says.

    Raises:
        OSError: if the file cannot be opened, or is not an image.
    """
    with Image.open(path) as image:
        return image.height, image.width
