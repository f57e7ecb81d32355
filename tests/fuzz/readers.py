"""All readers, by name."""

from __future__ import annotations

from collections.abc import Mapping

from .camera_readers import CAMERAS
from .command_line import COMMAND_LINE
from .dataset_readers import DATASETS
from .image_readers import IMAGES
from .judge import Reader
from .mesh_readers import MESHES
from .network_readers import NETWORKS
from .record_readers import RECORDS

READERS: Mapping[str, Reader] = {
    **DATASETS, **RECORDS, **NETWORKS, **MESHES, **CAMERAS, **IMAGES, **COMMAND_LINE,
}  # fmt: skip
"""What is fuzzed."""
