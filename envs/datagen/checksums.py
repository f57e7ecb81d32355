"""Checksums of a generated dataset, and checking it.

Lists are called ``SHA256SUMS`` and have the form that ``sha256sum -c`` reads. Each scene has one,
written when the scene is finished; the dataset has one, written when the run is finished, of all
files outside of the scenes and of the scenes' lists. So the one on top vouches for everything, and
no list grows with the number of images.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from tqdm import tqdm

from ...core.errors import InputError
from ...core.files import write_atomically

SUMS_FILE = "SHA256SUMS"

_LINE = re.compile(r"([0-9a-f]{64})  (\S.*)")


def write_sums(folder: Path, files: Iterable[str] | None = None) -> None:
    """Writes the list of a folder.

    Args:
        folder: where the list goes.
        files: names within it; None for all that are not hidden.
    """
    names = _files(folder) if files is None else files
    names = [n for n in names if n != SUMS_FILE and not Path(n).name.startswith(".")]
    text = "".join(f"{_digest(folder / name)}  {name}\n" for name in sorted(names))
    write_atomically(folder / SUMS_FILE, text.encode())


def write_dataset_sums(root: Path, split: str, files: Iterable[str]) -> None:
    """Writes the list on top of a dataset of one split.

    Args:
        root: the dataset's folder.
        split: the split's name; its scenes have lists.
        files: files and folders next to the split that belong to the dataset; those that are not
            there are left out.
    """
    names = [str(path.relative_to(root)) for path in (root / split).glob(f"*/{SUMS_FILE}")]
    for name in files:
        if (root / name).is_dir():
            names += [f"{name}/{file}" for file in _files(root / name)]
        elif (root / name).is_file():
            names.append(name)
    write_sums(root, names)


def read_sums(folder: Path) -> dict[str, str]:
    """The list of a folder: name -> SHA-256.

    Raises:
        InputError: if a line is not one of such a list.
    """
    sums = {}
    for number, line in enumerate((folder / SUMS_FILE).read_text().splitlines(), 1):
        match = _LINE.fullmatch(line)
        if match is None:
            raise InputError(f"{folder / SUMS_FILE}: line {number} is no checksum: {line[:80]!r}")
        sums[match[2]] = match[1]
    return sums


def find_problems(root: Path) -> Iterator[str]:
    """Checks every file of a dataset.

    Yields:
        A line for each file that is missing, changed or extra, such as
        ``changed train_pbr/000003/rgb/000001.jpg``. Of a scene without its list, the list.

    Raises:
        InputError: if there is no such folder, or a list cannot be read.
    """
    if not root.is_dir():
        raise InputError(f"there is no dataset to verify: {root} is not a folder")
    if not (root / SUMS_FILE).is_file():
        yield f"missing {SUMS_FILE}: the run is not finished; the same command finishes it"
        return
    listed = read_sums(root)
    scenes = [Path(name).parent for name in listed if Path(name).name == SUMS_FILE]
    lost = {scene for scene in scenes if not (root / scene / SUMS_FILE).is_file()}
    for scene in set(scenes) - lost:
        sums = read_sums(root / scene)
        listed |= {(scene / name).as_posix(): digest for name, digest in sums.items()}
    found = {name for name in _files(root) if lost.isdisjoint(Path(name).parents)} - {SUMS_FILE}
    for name in tqdm(sorted(listed.keys() | found), unit="file"):
        if name not in found:
            yield f"missing {name}"
        elif name not in listed:
            yield f"extra {name}"
        elif _digest(root / name) != listed[name]:
            yield f"changed {name}"


def verify(root: Path) -> int:
    """Checks a dataset and prints what is wrong; returns the number of problems."""
    count = 0
    for problem in find_problems(root):
        tqdm.write(problem)
        count += 1
    print(f"{root}: " + (f"{count} problems" if count else "all checksums match"))
    return count


def _digest(path: Path) -> str:
    """SHA-256 of a file, 64 hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _files(folder: Path) -> Iterator[str]:
    """Names of all files below a folder."""
    for path, _, files in os.walk(folder):
        yield from (Path(path, name).relative_to(folder).as_posix() for name in files)
