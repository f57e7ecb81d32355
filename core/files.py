"""Output files: atomic writes, and errors that name the file."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import InputError


def write_atomically(path: str | os.PathLike[str], content: bytes) -> None:
    """Writes bytes to a temporary file in the same folder, then renames it to ``path``.

    Raises:
        OSError: if that fails; it names ``path``.
    """
    target = Path(path)
    if target.exists() and not target.is_file():  # a device or a pipe, which must stay
        with naming(target):
            target.write_bytes(content)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(target)
    except OSError as error:
        if error.errno is None:
            raise
        raise _named(error, target) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Makes errors of the operating system name ``path`` where they name nothing (a full disk)."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise _named(error, path) from error


def _named(error: OSError, path: str | os.PathLike[str]) -> OSError:
    return OSError(error.errno, error.strerror, os.fspath(path))


def check_output(path: Path, name: str, folder: bool = False) -> None:
    """Checks before hours of work that its output can be written.

    Args:
        path: of the output.
        name: of the option, for errors.
        folder: whether it is a folder, not a file.

    Raises:
        InputError: if it is the other, or its folder cannot be made or written to.
    """
    if path.exists() and path.is_dir() != folder:
        found, wanted = ("a folder", "a file") if path.is_dir() else ("a file", "a folder")
        raise InputError(f"{name} must be {wanted}, and {path} is {found}")
    place = path.absolute() if folder else path.absolute().parent
    nearest = next(p for p in (place, *place.parents) if p.exists())
    if not nearest.is_dir():
        raise InputError(f"{name} cannot be {path}: {nearest} is a file, not a folder")
    if not os.access(nearest, os.W_OK):
        raise InputError(f"{name} cannot be {path}: no permission to write in {nearest}")
