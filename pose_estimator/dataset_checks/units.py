"""Units that explain lengths which are wrong by a factor."""

_UNITS = {"meters": 1000.0, "centimeters": 10.0, "inches": 25.4}
"""Millimeters in units that files hold by mistake."""

_TOLERANCE = 0.2


def unit_of_factor(ratio: float) -> tuple[str, float] | None:
    """Returns the unit of lengths that read as millimeters are too small by ``ratio``.

    Args:
        ratio: length as read over true length.

    Returns:
        The unit and its millimeters, or None where no unit explains the ratio.
    """
    for unit, factor in _UNITS.items():
        if abs(ratio * factor - 1) < _TOLERANCE:
            return unit, factor
    return None


def format_length(meters: float) -> str:
    """Formats a length."""
    return f"{meters:.4g} m" if meters >= 1 else f"{1e3 * meters:.4g} mm"
