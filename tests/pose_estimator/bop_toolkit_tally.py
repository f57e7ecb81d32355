"""What differs between our numbers and those of BOP's toolkit, and by how much."""

from __future__ import annotations

from typing import Any

import numpy as np

MM = 1000.0
"""Millimetres, the toolkit's unit, in a metre, ours."""


class Tally:
    """Largest absolute difference and count of each quantity."""

    def __init__(self) -> None:
        self.rows: dict[tuple[str, str], list[float]] = {}

    def add(self, quantity: str, unit: str, ours: Any, theirs: Any) -> None:
        """Compares two arrays of one shape, or numbers."""
        a, b = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
        if a.shape != b.shape:
            raise ValueError(f"{quantity}: ours is of shape {a.shape}, theirs of {b.shape}")
        row = self.rows.setdefault((quantity, unit), [0.0, 0])
        difference = float(np.abs(a - b).max(initial=0.0))
        row[0] = max(row[0], difference if np.isfinite(difference) else np.inf)
        row[1] += a.size

    def poses(self, what: str, ours: np.ndarray, R: np.ndarray, t: np.ndarray) -> None:
        """Compares a transform in metres with the toolkit's rotation and millimetres."""
        self.add(f"{what}, rotation", "1", ours[:3, :3], R)
        self.add(f"{what}, translation", "mm", ours[:3, 3] * MM, np.ravel(t))

    def records(self) -> list[dict[str, Any]]:
        return [
            {"quantity": name, "unit": unit, "largest_difference": row[0], "count": int(row[1])}
            for (name, unit), row in self.rows.items()
        ]
