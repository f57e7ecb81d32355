"""Bounding boxes as BOP files hold them."""

import numpy as np

Box = tuple[int, int, int, int]
"""Left, top, width, height in pixels; width is the last column minus the first, as in bop_toolkit,
one less than the number of columns covered."""

NO_BOX: Box = (-1, -1, -1, -1)
"""The box of an empty mask."""


def bounding_box(mask: np.ndarray) -> Box:
    """Returns the box of the nonzero pixels of a mask, bool or uint8 (H, W)."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not columns.size:
        return NO_BOX
    left, top = int(columns[0]), int(rows[0])
    return left, top, int(columns[-1]) - left, int(rows[-1]) - top
