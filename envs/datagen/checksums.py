"""Writes and verifies the checksums of a generated dataset.

``SHA256SUMS`` files have the format of ``sha256sum -c``. Each finished scene has one; the finished
dataset has one of all files outside of the scenes and of the scenes' lists, so that it covers
everything without growing with the number of images.
"""

import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from tqdm import tqdm

from ...core.errors import InputError
from ...core.files import write_atomically
from ...core.text_files import read_text

SUMS_FILE = "SHA256SUMS"

_LINE = re.compile(r"([0-9a-f]{64})  (\S.*)")


def write_sums(folder: Path, files: Iterable[str] | None = None) -> None:
    """Writes the list of ``files`` in a folder; None: of all that are not hidden."""
    names = _files(folder) if files is None else files
    names = [n for n in names if n != SUMS_FILE and not Path(n).name.startswith(".")]
    text = "".join(f"{_digest(folder / name)}  {name}\n" for name in sorted(names))
    write_atomically(folder / SUMS_FILE, text.encode())


def write_dataset_sums(root: Path, split: str, files: Iterable[str]) -> None:
    """Writes the top-level list of a dataset.

    Args:
        root: the dataset's folder.
        split: name of the split, whose scenes have lists.
        files: other files and folders of the dataset; missing ones are skipped.
    """
    names = [str(path.relative_to(root)) for path in (root / split).glob(f"*/{SUMS_FILE}")]
    for name in files:
        if (root / name).is_dir():
            names += [f"{name}/{file}" for file in _files(root / name)]
        elif (root / name).is_file():
            names.append(name)
    write_sums(root, names)


def read_sums(folder: Path) -> dict[str, str]:
    """Reads the list of a folder: name -> SHA-256; an InputError if a line is invalid."""
    sums = {}
    for number, line in enumerate(read_text(folder / SUMS_FILE).splitlines(), 1):
        match = _LINE.fullmatch(line)
        if match is None:
            raise InputError(
                f"{folder / SUMS_FILE}: line {number} is not a checksum: {line[:80]!r}"
            )
        sums[match[2]] = match[1]
    return sums


def find_problems(root: Path) -> Iterator[str]:
    """Checks every file of a dataset.

    Yields:
        A line for each file that is missing, changed or extra, such as
        ``changed train_pbr/000003/rgb/000001.jpg``. Of a scene without a list, only the list.

    Raises:
        InputError: if the folder is missing, or a list is invalid.
    """
    if not root.is_dir():
        raise InputError(f"there is no dataset to verify: {root} is not a folder")
    if not (root / SUMS_FILE).is_file():
        yield f"missing {SUMS_FILE}: the run is not finished; the same command resumes it"
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
    """Verifies a dataset, prints its problems and returns their number."""
    count = 0
    for problem in find_problems(root):
        tqdm.write(problem)
        count += 1
    print(f"{root}: " + (f"{count} problems" if count else "all checksums match"))
    return count


def _digest(path: Path) -> str:
    """Returns the SHA-256 of a file, 64 hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _files(folder: Path) -> Iterator[str]:
    """Yields the names of all files below a folder."""
    for path, _, files in os.walk(folder):
        yield from (Path(path, name).relative_to(folder).as_posix() for name in files)
