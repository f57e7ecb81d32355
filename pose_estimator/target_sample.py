"""One training crop: picture, mask, votes and camera; and many of them as tensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .features import FeatureConfig


@dataclass(frozen=True, eq=False)
class TargetSample:
    """One training crop.

    Attributes:
        crop: RGB uint8 (S, S, 3).
        mask: (G, G) float32, covered fraction of each cell by the visible object.
        directions: (9, 2, G, G) float32 unit vectors towards the keypoints.
        object_index: which object.
        K: (3, 3) camera of the crop (any affine of the true one, turned and shifted).
        T_cam_obj: (4, 4) the pose that is trained.
        depth: (S, S) float32 metres along the camera's z, of all that the crop shows, 0 = unknown;
            None where the dataset has no depth maps.
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
    # Within half a cell the direction means nothing; let it go to zero there.
    return field / np.maximum(np.linalg.norm(field, axis=1, keepdims=True), config.stride / 2)


def stack_targets(samples: list[TargetSample]) -> dict[str, Tensor]:
    """Collates samples into a batch; crops become float (B, 3, S, S), channels last."""
    crops = torch.from_numpy(np.stack([s.crop for s in samples])).permute(0, 3, 1, 2).float()
    return {
        "crop": crops,
        "mask": torch.from_numpy(np.stack([s.mask for s in samples])),
        "directions": torch.from_numpy(np.stack([s.directions for s in samples])),
        "object": torch.tensor([s.object_index for s in samples]),
        "K": torch.from_numpy(np.stack([s.K for s in samples])).float(),
        "T_cam_obj": torch.from_numpy(np.stack([s.T_cam_obj for s in samples])).float(),
    }


def generator_of(sample: TargetSample, seed: int) -> np.random.Generator:
    """A generator for what else is random about a sample that was drawn.

    It is the same wherever in a batch the sample stands, and another one for another draw of the
    same target, whose camera K is jittered.
    """
    return np.random.default_rng([seed, *np.ascontiguousarray(sample.K).view(np.uint32).flat])
