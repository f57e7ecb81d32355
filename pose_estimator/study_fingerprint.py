"""What a measured outcome depends on, as digests: it is good as long as these do not change."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from torch import nn

PARTS = {
    "single": ("detector", "features"),
    "late": ("detector", "features"),
    "mid": ("detector", "features", "volume"),
    "early": ("detector", "features", "cascade"),
    "rgbd": ("detector", "features", "points"),
}
"""The networks that a method uses."""

_PACKAGE = __name__.split(".")[0]


def of_file(path: str | Path) -> str:
    """A digest of a file's bytes."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16]


def of_networks(networks: nn.Module, parts: Sequence[str]) -> str:
    """A digest of the numbers in some parts of the networks."""
    sha = hashlib.sha256()
    for name, value in networks.state_dict().items():
        if name.split(".")[0] in parts and not name.endswith("num_batches_tracked"):
            sha.update(name.encode() + value.detach().cpu().contiguous().numpy().tobytes())
    return sha.hexdigest()[:16]


def of_code(method: type) -> str:
    """A digest of the source files of this package that a class is made of.

    These are its own and, again and again, those that a file has functions, classes or modules
    from. What is imported inside of a function is not seen.
    """
    sha = hashlib.sha256()
    for name in sorted(_used_by(method.__module__)):
        file = sys.modules[name].__file__
        if file is not None:
            sha.update(name.encode() + Path(file).read_bytes())
    return sha.hexdigest()[:16]


def _used_by(start: str) -> set[str]:
    """Names of the loaded modules of this package that a module uses, its own among them."""
    found, open_ends = {start}, [start]
    while open_ends:
        for value in list(vars(sys.modules[open_ends.pop()]).values()):
            name = value.__name__ if isinstance(value, ModuleType) else _home(value)
            inside = name.split(".")[0] == _PACKAGE and name in sys.modules
            if inside and name not in found:
                found.add(name)
                open_ends.append(name)
    return found


def _home(value: object) -> str:
    """The name of the module that a function, class or instance is from, or empty text."""
    name = getattr(value, "__module__", None)
    return name if isinstance(name, str) else ""
