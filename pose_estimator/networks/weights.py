"""Weights files: tensors in safetensors, with a JSON header."""

import hashlib
import json
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from ... import assets
from ...assets.storage import read_object, save_object
from ...core.errors import InputError
from ...core.files import write_atomically
from ...core.results import commit, versions
from ...core.text_files import read_text
from ..methods import OPTIONAL_PARTS, PARTS
from .container import NetworkConfig, PoseNetworks
from .detector import DetectorConfig
from .features import FeatureConfig
from .quantization import pack, quantizable, unpack

FORMAT = 3
STORAGE = (
    "weights of convolutions and linear layers: int8 with a bfloat16 scale for each output "
    "channel; batch statistics: float32; all else, the encoders' first layers too: float16"
)
"""The header's description of the number formats."""

MAX_SIZE = 2048
"""Of layers and images, in a header: a damaged one must not fill the memory."""

SHIPPED = Path(assets.__file__).parent / "weights"
"""Folder of the weights that ship with the package."""


def save_weights(
    networks: PoseNetworks,
    path: str | Path,
    header: dict[str, Any],
    *,
    surfaces: bool = True,
    base: str | None = None,
) -> None:
    """Writes weights (see :func:`pack`) and their header, ``.json`` in the same folder.

    ``OPTIONAL_PARTS`` are written if they are trained. Objects that do not ship with the package
    are stored in a folder next to the header.

    Args:
        networks: what to save.
        path: the ``.safetensors`` file.
        header: of the weights: training data, measured accuracy. The objects, shapes, trained
            parts, versions and the commit are added.
        surfaces: whether the meshes of these objects are stored too.
        base: shipped weights that these were trained from; only what differs is written, and the
            file can be read wherever they are shipped.

    Raises:
        InputError: if the networks hold NaN or infinite numbers.
        FileNotFoundError: if no such weights are shipped.
    """
    path = Path(path)
    tensors = pack(exported_state_dict(networks), quantizable(networks))
    if base is not None:
        base = read_header(find_weights(base)).get("base", {}).get("name", base)
        known = load_file(find_weights(base))
        tensors = {
            name: value
            for name, value in tensors.items()
            if name not in known or not torch.equal(value, known[name])
        }
        header = {**header, "base": {"name": base, "sha256": _sha256(find_weights(base))}}
    objects: dict[str, dict[str, Any]] = {}
    for name, model in networks.objects.items():
        objects[name] = {"obj_id": model.obj_id, "diameter": model.diameter}
        if name not in assets.OBJECT_NAMES or model is not assets.load_object(name):
            # Weights of a user's objects must not depend on the path of their meshes.
            objects[name]["folder"] = f"{path.stem}_objects/{name}"
            surface = surfaces and model.has_surface
            save_object(model, path.parent / objects[name]["folder"], surface=surface)
    full = {
        "format": FORMAT,
        "storage": STORAGE,
        "objects": objects,
        "networks": asdict(networks.config),
        "trained": [part for part in PARTS if part in networks.trained],
        "versions": versions(),
        "commit": commit(),
        **header,
    }
    write_atomically(path, save(tensors))
    write_atomically(path.with_suffix(".json"), (json.dumps(full, indent=1) + "\n").encode())


def read_header(path: str | Path) -> dict[str, Any]:
    """The header of a weights file.

    Raises:
        FileNotFoundError: if it is missing.
        InputError: if it cannot be read.
    """
    path = Path(path).with_suffix(".json")
    if not path.is_file():
        raise FileNotFoundError(f"weights header {path} is missing (expected next to the weights)")
    try:
        header = json.loads(read_text(path))
        if header["format"] != FORMAT:
            raise InputError(
                f"it has format {header['format']} and this version reads {FORMAT}; train "
                "again with train-estimator, or use the version that made it"
            )
        return header
    except (ValueError, KeyError, RecursionError, TypeError) as error:
        raise InputError(f"weights header {path} cannot be read: {error}") from error


def find_weights(weights: str | Path) -> Path:
    """The file of shipped weights by name, or of a user's weights by path.

    Raises:
        FileNotFoundError: if there is none; names the shipped weights.
    """
    path = Path(weights)
    if path.suffix.lower() == ".safetensors":
        if path.is_file():
            return path
        raise FileNotFoundError(f"weights file {path} does not exist")
    shipped = SHIPPED / f"{weights}.safetensors"
    if shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.safetensors"))) or "none"
    raise FileNotFoundError(
        f"there are no weights named {str(weights)!r}; shipped weights: {names}. Give one of "
        "these, a path to a .safetensors file, or train some: "
        "python -m two_view_pose train-estimator --help"
    )


@lru_cache(maxsize=8)
def _load_cached(path: Path, modified: int, device: torch.device) -> PoseNetworks:
    return read_networks(path).to(device)


def load_networks(
    weights: str | Path = "linemod", device: torch.device = torch.device("cpu")
) -> PoseNetworks:
    """Networks in evaluation mode; cached, so callers share them.

    Raises:
        FileNotFoundError, ValueError: see :func:`find_weights` and :func:`read_networks`.
    """
    path = find_weights(weights)
    return _load_cached(path.resolve(), path.stat().st_mtime_ns, device).eval()


def read_networks(path: str | Path) -> PoseNetworks:
    """Builds the networks that a weights file describes, without running code from the file.

    Objects are read from the weights' folder or are the package's. Untrained optional parts keep
    their initial values.

    Raises:
        InputError: if the file is damaged, or does not fit its header.
    """
    path = Path(path)
    header = read_header(path)
    try:
        shapes = header["networks"]
        config = NetworkConfig(
            detector=DetectorConfig(**shapes["detector"]),
            features=FeatureConfig(**shapes["features"]),
            preset=shapes["preset"],
        )
        _check_shapes(config)
        objects = {
            name: read_object(path.parent / entry["folder"])
            if "folder" in entry
            else assets.load_object(name)
            for name, entry in header["objects"].items()
        }
        networks = PoseNetworks(objects, config)
        networks.trained = frozenset(header["trained"])
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise InputError(f"the header of {path} does not describe networks: {error}") from error
    unknown = sorted(map(str, networks.trained.difference(PARTS)))
    if unknown:
        raise InputError(
            f"the header of {path} says that the parts {unknown} are trained; there are "
            f"{', '.join(PARTS)}"
        )
    try:
        tensors = unpack(_read_base(header) | load_file(path))
    except (KeyError, OSError, SafetensorError, TypeError, ValueError) as error:
        raise InputError(f"weights file {path} is damaged: {error}") from error
    if not all(torch.isfinite(tensor).all() for tensor in tensors.values()):
        raise InputError(f"weights file {path} is damaged: it holds NaN or infinite numbers")
    expected = exported_state_dict(networks)
    wrong = [n for n in expected if n not in tensors or tensors[n].shape != expected[n].shape]
    if wrong or len(tensors) != len(expected):
        raise InputError(
            f"weights file {path} does not fit its header: "
            f"{', '.join(wrong[:3]) or 'more tensors than the networks have'}"
        )
    networks.load_state_dict(tensors, strict=False)
    return networks.eval()


def _check_shapes(config: NetworkConfig) -> None:
    """Raises ValueError where networks cannot be of these shapes."""
    detector, features = config.detector, config.features
    sizes = (
        detector.height, detector.width, detector.channels,
        features.crop, features.width, features.volume_channels,
    )  # fmt: skip
    fits = all(type(size) is int and 0 < size <= MAX_SIZE for size in sizes)
    fits &= (detector.stride, features.stride) == (DetectorConfig().stride, FeatureConfig().stride)
    fits &= features.crop % 32 == 0 and isinstance(features.own_decoders, bool)
    if not fits or not all(0.1 <= part.roi_scale <= 10 for part in (detector, features)):
        raise ValueError(f"no networks are of the shapes {config!s:.300}")


def _read_base(header: dict[str, Any]) -> dict[str, Tensor]:
    """Returns the packed tensors of the shipped weights that these build on; {} for none."""
    if "base" not in header:
        return {}
    name, path = header["base"]["name"], SHIPPED / f"{header['base']['name']}.safetensors"
    if not path.is_file() or _sha256(path) != header["base"]["sha256"]:
        raise InputError(
            f"these weights hold only what differs from the shipped weights {name!r} of another "
            "version: use the version that made them, or train them again"
        )
    return load_file(path)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def exported_state_dict(networks: PoseNetworks) -> dict[str, Tensor]:
    """The tensors that a weights file of these networks contains."""
    left_out = tuple(f"{part}." for part in OPTIONAL_PARTS if part not in networks.trained)
    return {
        name: value
        for name, value in networks.state_dict().items()
        if not name.endswith("num_batches_tracked") and not name.startswith(left_out)
    }
