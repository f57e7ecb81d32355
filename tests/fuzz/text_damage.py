"""Damages text: lines, numbers, separators, encodings."""

from __future__ import annotations

import re

import numpy as np

NUMBERS = (
    "nan", "inf", "-inf", "1e999", "-1", "0", "1e-320", "9" * 400, "9" * 5000, "0x10", "1_0", "١",
    "²", "", "1,5", "1.2.3", "--1", "1e", "4294967296", "2147483648", "9" * 20, "true",
)  # fmt: skip
"""What takes the place of a number."""

ENCODINGS = ("utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "cp500")

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")


def damage_text(content: bytes, rng: np.random.Generator) -> bytes:
    """Changes text in one or two ways; its first part may be text of a binary file."""
    for _ in range(int(rng.integers(1, 3))):
        content = _change(content.decode("latin-1"), rng)
    return content


def _change(text: str, rng: np.random.Generator) -> bytes:
    kind = int(rng.integers(10))
    lines = text.split("\n")
    at = int(rng.integers(len(lines)))
    if kind == 0:
        text = text[: int(rng.integers(len(text) + 1))]
    elif kind == 1:
        text = "\n".join(lines[:at] + lines[at + 1 :])
    elif kind == 2:
        text = "\n".join([*lines[:at], lines[at], *lines[at:]])
    elif kind in (3, 4, 5):
        found = list(_NUMBER.finditer(text))
        if found:
            match = found[int(rng.integers(len(found)))]
            number = NUMBERS[int(rng.integers(len(NUMBERS)))]
            return (
                text[: match.start()].encode("latin-1")
                + number.encode()
                + text[match.end() :].encode("latin-1")
            )
    elif kind == 6:
        old, new = rng.choice([",", " ", "\n", ".", "\t", ";", ":"], 2, replace=False)
        text = text.replace(old, new)
    elif kind == 7:
        return text.encode(str(rng.choice(ENCODINGS)))
    elif kind == 8:
        where = int(rng.integers(len(text) + 1))
        added = ["\0", "é", "\x1a", "\r", '"', "#", "\x85", "x" * 100_000, "\n" * 1000, "%", "{"]
        text = text[:where] + added[int(rng.integers(len(added)))] + text[where:]
    else:
        rng.shuffle(lines)
        text = "\n".join(lines)
    return text.encode("latin-1", "replace")
