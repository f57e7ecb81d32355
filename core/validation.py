"""Checks of settings and numbers: errors name the field, what is allowed, and the value."""

import math
import sys
from collections.abc import Iterable, Sequence
from numbers import Real
from typing import TypeGuard

from .errors import InputError


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether a value, as of a JSON file, is a finite number: no bool, NaN or 10**400."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max


def require_within(config: object, low: float, high: float, *names: str, prefix: str = "") -> None:
    """Checks that fields of ``config`` are finite numbers in [``low``, ``high``].

    Errors name a field with ``prefix`` before it.

    Raises:
        InputError: if one is not.
    """
    for name in names:
        value = getattr(config, name)
        _require((value,), low, high, f"{prefix}{name} must be", value)


def require_range(config: object, low: float, high: float, *names: str) -> None:
    """Checks that fields of ``config`` are pairs (min, max) within [``low``, ``high``].

    Raises:
        InputError: if one is not.
    """
    for name in names:
        value = getattr(config, name)
        _require(value, low, high, f"{name} must be (min, max) and", value)


def require_choice(config: object, choices: Iterable[str], name: str) -> None:
    """Checks that a field of ``config`` is one of ``choices``.

    Raises:
        InputError: if it is not.
    """
    value = getattr(config, name)
    if value not in (allowed := tuple(choices)):
        raise InputError(f"{name} must be one of {', '.join(allowed)}, got {value!r}")


def _require(numbers: Sequence, low: float, high: float, subject: str, value: object) -> None:
    finite = all(isinstance(n, Real) and math.isfinite(n) for n in numbers)
    if not (finite and low <= numbers[0] <= numbers[-1] <= high):
        allowed = f"{low:g} to {high:g}" if high < math.inf else f">= {low:g}"
        raise InputError(f"{subject} {allowed}, got {value!r}")
