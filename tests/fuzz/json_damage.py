"""Damages JSON: keys and values of a document, which stays JSON, or nearly."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from two_view_pose.core.validation import is_number

VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 7, 0.5, -0.0, 1e-300, 1e300, 999_999_999, 2**31, 2**63, 2**64,
    10**400, float("nan"), float("inf"), float("-inf"), "", "1", "-1", "nan", "text", "²", "١٢",
    "a\0b", "\ud800", "../..", "/", "x" * 100_000, [], {}, [[]], [None], [0] * 3, [0.0] * 9,
    [1, 0, 0, 0, 1, 0, 0, 0, 1], [1] * 16, [0] * 100_000, {"": None}, {"0": []}, {"1": {}},
)  # fmt: skip
"""What takes the place of a value."""

KEYS = ("", "²", "١", "-1", "00", "1.5", "99999999999999999999", "a\0b", "\ud800", "x" * 10_000)
"""What takes the place of a key."""

FACTORS = (-1.0, 0.0, 0.001, 0.1, 1.05, 1000.0, 1e12)

_TWICE = "\x01twice"
"""At the end of a key that is written without this, so that two are equal."""


def damage_json(content: bytes, rng: np.random.Generator) -> bytes:
    """Changes one to three places of a document."""
    document = {"": json.loads(content)}
    for _ in range(int(rng.integers(1, 4))):
        places = list(_places(document))
        holder, key = places[int(rng.integers(len(places)))]
        _change(holder, key, rng)
    text = json.dumps(document.get("")).replace("\\u0001twice", "")
    if rng.random() < 0.03:
        text = text.replace("1", "9" * 5000, 1)
    if rng.random() < 0.02:
        text = "[" * 100_000 + text
    return text.encode()


def _places(node: Any) -> Iterator[tuple[Any, Any]]:
    """All values of a document: what holds them, and the key or index."""
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in list(items):
        yield node, key
        if isinstance(value, dict | list) and len(value) < 10_000:
            yield from _places(value)


def _change(holder: Any, key: Any, rng: np.random.Generator) -> None:
    value, kind = holder[key], int(rng.integers(9))
    if kind == 0 and len(holder) > 1:
        del holder[key]
    elif kind == 1 and isinstance(holder, list):
        holder.insert(key, copy.deepcopy(value))
    elif kind == 1 and key:
        holder[key + _TWICE] = _value(rng)
    elif kind == 2 and isinstance(holder, dict) and key:
        holder[KEYS[int(rng.integers(len(KEYS)))]] = holder.pop(key)
    elif kind in (3, 4) and is_number(value):
        holder[key] = value * FACTORS[int(rng.integers(len(FACTORS)))]
    elif kind == 5 and isinstance(value, list):
        holder[key] = value[::-1] if rng.random() < 0.5 else value[: len(value) // 2]
    elif kind == 6:
        holder[key] = [value] if rng.random() < 0.5 else json.dumps(value)
    else:
        holder[key] = _value(rng)


def _value(rng: np.random.Generator) -> Any:
    return copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])
