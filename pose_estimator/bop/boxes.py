"""Boxes of BOP files: what they mean, and the box of a mask."""

from __future__ import annotations

import numpy as np

Box = tuple[int, int, int, int]
"""Left, top, width and height in pixels; all -1 where there is nothing to enclose.

As bop_toolkit counts them: width is the last column minus the first, one less than the columns
covered."""

NO_BOX: Box = (-1, -1, -1, -1)
"""The box of nothing."""


def bounding_box(mask: np.ndarray) -> Box:
    """The box of a mask's true pixels, as bool (H, W) or uint8."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not columns.size:
        return NO_BOX
    left, top = int(columns[0]), int(rows[0])
    return left, top, int(columns[-1]) - left, int(rows[-1]) - top
