"""One training crop with its labels, and its arrays for a batch."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from ..networks.features import FeatureConfig


@dataclass(frozen=True, eq=False)
class TargetSample:
    """One training crop.

    Attributes:
        crop: RGB uint8 (S, S, 3).
        mask: (G, G) float32, covered fraction of each cell by the visible object.
        directions: (9, 2, G, G) float32 unit vectors towards the keypoints.
        object_index: of the target.
        K: (3, 3) camera of the crop (an affine map times the true one).
        T_cam_obj: (4, 4) the canonical equivalent of the pose.
        depth: (S, S) float32 meters along the camera's z, background included, 0 = unknown; None
            if the dataset has no depth maps.
    """

    crop: np.ndarray
    mask: np.ndarray
    directions: np.ndarray
    object_index: int
    K: np.ndarray
    T_cam_obj: np.ndarray
    depth: np.ndarray | None = None


def direction_field(pixels: np.ndarray, config: FeatureConfig) -> np.ndarray:
    """Unit vectors (9, 2, G, G) from each output cell to keypoints (9, 2) in crop pixels."""
    cells = np.arange(config.grid) * config.stride + (config.stride - 1) / 2
    field = np.empty((len(pixels), 2, config.grid, config.grid), np.float32)
    field[:, 0] = pixels[:, 0, None, None] - cells[None, None, :]
    field[:, 1] = pixels[:, 1, None, None] - cells[None, :, None]
    # The direction is undefined within half a cell; let it go to zero there.
    return field / np.maximum(np.linalg.norm(field, axis=1, keepdims=True), config.stride / 2)


def target_arrays(sample: TargetSample) -> dict[str, Any]:
    """The arrays of a sample for a batch of single crops."""
    return {
        "crop": sample.crop,
        "mask": sample.mask,
        "directions": sample.directions,
        "object": sample.object_index,
        "K": sample.K.astype(np.float32),
        "T_cam_obj": sample.T_cam_obj.astype(np.float32),
    }


def pair_arrays(first: TargetSample, second: TargetSample) -> dict[str, Any]:
    """The arrays of a pair for a batch: crops and cameras of both views, the pose of the first."""
    return {
        "crop": np.stack([first.crop, second.crop]),
        "object": first.object_index,
        "K": np.stack([first.K, second.K]).astype(np.float32),
        "T_cam_obj": first.T_cam_obj.astype(np.float32),
    }


def as_input(images: Tensor) -> Tensor:
    """Converts images (..., H, W, 3) uint8 to a network's input (B, 3, H, W), channels last."""
    return images.flatten(0, -4).permute(0, 3, 1, 2).float()
