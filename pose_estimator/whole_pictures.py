"""Is a picture file whole: decoders hand out half a picture without a word."""

from __future__ import annotations

import struct
import zlib

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG, _JPEG_END = b"\xff\xd8", b"\xff\xd9"


def is_whole(data: bytes) -> bool:
    """Whether a PNG's checksums are right and it ends, or a JPEG ends; True for other formats."""
    if data.startswith(_PNG):
        return _png_is_whole(data)
    if data.startswith(_JPEG):
        return _JPEG_END in data[2:]
    return True


def _png_is_whole(data: bytes) -> bool:
    start = len(_PNG)
    while start + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, start)
        end = start + 8 + length
        if end + 4 > len(data):
            return False
        (checksum,) = struct.unpack_from(">I", data, end)
        if zlib.crc32(data[start + 4 : end]) != checksum:
            return False
        if data[start + 4 : start + 8] == b"IEND":
            return True
        start = end + 4
    return False
