"""Damages the files of a reader, reads them, and says how that ends."""

from __future__ import annotations

import os
import shutil
import traceback
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from two_view_pose.__main__ import message
from two_view_pose.core.errors import InputError

from .damage import damage

REFUSED, READ = "refused", "read"
"""Good ends."""

LONGEST_MESSAGE = 2000
"""A message in which a whole file stands tells nobody anything."""


class Nonsense(AssertionError):
    """What was read is not valid."""


@dataclass(frozen=True)
class Reader:
    """What reads files of one kind.

    Attributes:
        write: writes valid files into an empty folder.
        damaged: patterns of the files to damage, one at a time.
        read: reads the files of a folder, and raises `Nonsense` where the value is not valid.
        change: damages the folder instead of ``damage``, and returns what ``read`` is given.
        named: whether a refusal must name a file of the folder.
    """

    write: Callable[[Path], None]
    damaged: tuple[str, ...]
    read: Callable[[Any], None]
    change: Callable[[Path, np.random.Generator], Any] | None = None
    named: bool = True


@dataclass(frozen=True)
class End:
    """How reading ended: `REFUSED`, `READ`, or what was wrong, with details."""

    kind: str
    detail: str = ""

    @property
    def good(self) -> bool:
        return self.kind in (REFUSED, READ)


def require(valid: Any, what: str) -> None:
    """Raises `Nonsense` unless all of ``valid`` is true."""
    if not np.all(valid):
        raise Nonsense(what)


def make_input(reader: Reader, name: str, valid: Path, folder: Path, number: int) -> Any:
    """Writes input number ``number`` into a new folder: a copy of the valid files with damage."""
    rng = np.random.default_rng([number, zlib.crc32(name.encode())])
    shutil.copytree(valid, folder, copy_function=os.link)
    if reader.change is not None:
        return reader.change(folder, rng)
    files = sorted({path for pattern in reader.damaged for path in folder.glob(pattern)})
    damage(files[int(rng.integers(len(files)))], rng)
    return folder


def judge(reader: Reader, given: Any, folder: Path) -> End:
    """Reads an input."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        end = _read(reader, given, folder)
    overflows = [w for w in caught if issubclass(w.category, RuntimeWarning)]
    if end.kind == READ and overflows:
        first = overflows[0]
        return End("overflow", f"{first.filename}:{first.lineno}: {first.message}")
    return end


def _ran_out(error: BaseException | None) -> bool:
    """Whether an error, or one that it was made of, is that there is no more memory."""
    while error is not None:
        text = str(error).lower()
        if isinstance(error, MemoryError) or ("alloc" in text and "memory" in text):
            return True
        error = error.__cause__ or error.__context__
    return False


def _read(reader: Reader, given: Any, folder: Path) -> End:
    try:
        reader.read(given)
    except MemoryError:
        return End("memory", traceback.format_exc())
    except Nonsense as error:
        return End("nonsense", str(error)[:300])
    except (InputError, OSError) as error:
        text = message(error)
        if _ran_out(error):
            return End("memory", traceback.format_exc())
        names = [path.name for path in folder.rglob("*") if path.is_file()]
        if reader.named and not any(name in text for name in [str(folder), *names]):
            return End("unnamed", f"{text[:300]}\n{traceback.format_exc()}")
        if len(text) > LONGEST_MESSAGE:
            return End("long", f"{text[:300]}...\n{traceback.format_exc()[-3000:]}")
        return End(REFUSED, text)
    except Exception:
        return End("traceback", traceback.format_exc())
    return End(READ)
