"""Units of length of mesh files."""

from typing import Literal

from .errors import InputError

LengthUnit = Literal["auto", "m", "cm", "mm", "inch"]
"""Unit of a mesh file, which most formats do not store; ``auto``: as its size tells."""

METERS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254}
"""Meters in each unit."""

NAMES = {"m": "meters", "cm": "centimeters", "mm": "millimeters", "inch": "inches"}

PLAUSIBLE_RANGE = (1e-3, 10.0)
"""Allowed diameters of objects, meters."""

_GUESSED = {"m": (0.02, 1.0), "mm": (20.0, 1000.0)}
"""Diameters, as numbers of the file, that tell the unit. Centimeters and inches are never guessed:
their numbers mean millimeters more often."""


def resolve_unit(unit: str, diameter: float, path: object) -> str:
    """Returns the unit of a mesh file: one of ``METERS``.

    Args:
        unit: as requested, a ``LengthUnit``.
        diameter: of the mesh, as a number of its file.
        path: of the file, for messages.

    Raises:
        InputError: if ``auto`` cannot tell it, or the object has an implausible size in it.
    """
    if unit == "auto":
        for guess, (low, high) in _GUESSED.items():
            if low <= diameter <= high:
                return guess
        means = ", ".join(f"{length(diameter * m)} in {NAMES[u]}" for u, m in METERS.items())
        raise InputError(
            f"the unit of {path} is ambiguous: its diameter is {diameter:g}, which is {means}; "
            "pass --unit mm, cm, m or inch (in Python unit='mm' and so on)"
        )
    meters = diameter * METERS[check_unit(unit)]
    if not PLAUSIBLE_RANGE[0] <= meters <= PLAUSIBLE_RANGE[1]:
        raise InputError(
            f"{path} has a diameter of {diameter:g} {unit} = {meters:g} m; objects must be "
            f"{PLAUSIBLE_RANGE[0]:g} to {PLAUSIBLE_RANGE[1]:g} m"
        )
    return unit


def check_unit(unit: str) -> str:
    """Returns a unit other than ``auto``.

    Raises:
        InputError: if it is unknown.
    """
    if unit not in METERS:
        raise InputError(f"unit must be 'auto', {', '.join(map(repr, METERS))}, got {unit!r}")
    return unit


def length(meters: float) -> str:
    """Formats a length in meters, or in millimeters below one."""
    return f"{meters:.4g} m" if meters >= 1 else f"{1e3 * meters:.4g} mm"
