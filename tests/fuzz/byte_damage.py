"""Damages bytes: bits, lengths, pieces."""

from __future__ import annotations

import struct

import numpy as np

COUNTS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 100_000_000)
"""What takes the place of a length or a count in a header."""

_HEADER = 128


def damage_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Changes bytes in one to three ways; half of the changes are near the beginning."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 4))):
        reach = min(len(data), _HEADER) if rng.random() < 0.5 else len(data)
        _change(data, int(rng.integers(reach + 1)), rng)
    return bytes(data)


def _change(data: bytearray, at: int, rng: np.random.Generator) -> None:
    kind = int(rng.integers(8))
    length = int(rng.integers(1, 64))
    if kind == 0:
        for place in rng.integers(max(1, len(data)), size=int(rng.integers(1, 16))).tolist():
            if data:
                data[place] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        del data[at:]
    elif kind == 2:
        data[at : at + length] = bytes(len(data[at : at + length]))
    elif kind == 3:
        data += bytes(length) if rng.random() < 0.5 else rng.bytes(length)
    elif kind in (4, 5):
        count = COUNTS[int(rng.integers(len(COUNTS)))]
        form = ("<", ">")[int(rng.integers(2))] + "BHIQ"[int(rng.integers(4))]
        packed = struct.pack(form, count & (256 ** struct.calcsize(form) - 1))
        data[at : at + len(packed)] = packed
    elif kind == 6:
        del data[at : at + length]
    else:
        data[at:at] = data[at : at + length]
