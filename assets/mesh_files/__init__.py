"""Reads mesh files with all their colors: one reader for each format, the same checks for all.

`read_parts` is the one door; ``paint`` says what color a part has where.
"""

from .paint import Paint, unpainted
from .part import Part
from .ply import open_ply
from .reader import MESH_SUFFIXES, read_parts

__all__ = ["MESH_SUFFIXES", "Paint", "Part", "open_ply", "read_parts", "unpainted"]
