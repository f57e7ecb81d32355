"""Training of ``early``'s cascade: pairs of crops with depth, on frozen 2D features."""

from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from ..networks.cascade import CascadeViews, DepthOutput, half_range
from ..training_data.dataset import TrainingSet
from ..training_data.target_sample import as_input, pair_arrays
from .loader import Batch, Sample, SampleFunction
from .stage_base import FrozenFeatureStage

_LEVEL_WEIGHTS = {"coarse": 0.5, "middle": 1.0, "fine": 2.0}
"""Loss weights of the levels, as in Cas-MVSNet."""

_BACKGROUND = 0.1
"""Weight of a background pixel."""

_MAX_DEPTH_SLOPE = 6.0
"""Maximum depth difference of neighboring pixels, in widths of a crop pixel; more is an edge, which
has no depth to learn. A packed crop repeats pixels, so a slope may rise by two at once."""

_GUESS_NOISE = 0.25
"""Standard deviation of the guessed depth of the center, in half ranges: the surface, which is at
most half a diameter from the center, is to stay in the range."""

_MAX_GUESS_ERROR = 0.5


class DepthTarget(NamedTuple):
    """Ground truth of a level's depth map.

    Attributes:
        depth: (B, H, W) m, 0 where unknown.
        mask: (B, H, W) covered fraction of each cell by the visible object.
    """

    depth: Tensor
    mask: Tensor


class CascadeStage(FrozenFeatureStage):
    """The depth of the reference view from pairs."""

    name = part = "cascade"
    needs_depth = True
    validation = (16, 8)

    def sample_function(self, source: TrainingSet) -> SampleFunction:
        return partial(draw_pair_with_depth, source)

    def forward(self, batch: Batch) -> tuple[list[DepthOutput], list[DepthTarget]]:
        """Returns the predictions and targets of each level for a batch."""
        networks = self.networks
        networks.features.eval()
        diameter, distance = self.diameters[batch["object"]], batch["T_cam_obj"][:, 2, 3]
        count = len(diameter)
        search_range = half_range(networks.cascade.config.levels[0], diameter)
        with self.autocast():
            with torch.no_grad():
                maps = networks.features.encoder.pyramid(as_input(batch["crop"]))[:4]
            T_second_ref = batch["T_second_ref"]
            identity = torch.eye(4, device=self.device).expand_as(T_second_ref)
            outputs = networks.cascade(
                CascadeViews(
                    maps=tuple(m.unflatten(0, (count, 2)) for m in maps),
                    K=batch["K"],
                    T_view_ref=torch.stack([identity, T_second_ref], 1),
                ),
                distance + batch["guess_error"] * search_range,
                diameter,
            )
        focal = torch.linalg.det(batch["K"][:, 0, :2, :2]).abs().sqrt()
        targets = [
            depth_target(batch["depth"], batch["mask"], output.stride, distance / focal)
            for output in outputs
        ]
        return outputs, targets

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        self.networks.cascade.train()
        outputs, targets = self.forward(batch)
        levels = self.networks.cascade.config.levels
        parts = {
            name: depth_loss(output, target, level.planes)
            for name, level, output, target in zip(
                _LEVEL_WEIGHTS, levels, outputs, targets, strict=True
            )
        }
        total = torch.zeros((), device=self.device)
        for name, weight in _LEVEL_WEIGHTS.items():
            total = total + weight * parts[name]
        return total, parts

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Absolute error of the depth on the object in millimeters: median and 80th percentile."""
        self.networks.cascade.eval()
        errors = []
        for batch in self.held_out_batches():
            outputs, targets = self.forward(batch)
            on_object = (targets[-1].depth > 0) & (targets[-1].mask > 0.5)
            errors.append((outputs[-1].depth - targets[-1].depth)[on_object].abs())
        error = 1000 * torch.cat(errors).cpu().numpy()
        return {
            "depth_error_mm": float(np.median(error)),
            "depth_error_mm_p80": float(np.quantile(error, 0.8)),
        }


def draw_pair_with_depth(source: TrainingSet, rng: np.random.Generator) -> Sample:
    """Draws a pair, the depth of its first view, and the error of its center's guessed depth."""
    first, second, T_second_ref = source.draw_pair(rng)
    error = np.clip(rng.normal(0, _GUESS_NOISE), -_MAX_GUESS_ERROR, _MAX_GUESS_ERROR)
    return {
        **pair_arrays(first, second),
        "mask": first.mask,
        "depth": first.depth,
        "T_second_ref": T_second_ref.astype(np.float32),
        "guess_error": np.float32(error),
    }


def depth_target(depth: Tensor, mask: Tensor, stride: int, pixel_width: Tensor) -> DepthTarget:
    """Downsamples depth and mask to a grid of cells.

    The depth of a cell is the mean of the four pixels around its center, if all are known and none
    is across an edge.

    Args:
        depth: (B, S, S) of a crop, m, 0 where unknown.
        mask: (B, G, G) covered fraction by the visible object.
        stride: pixels of the crop per cell, even.
        pixel_width: (B,) width of a crop pixel at the object's distance, m.
    """
    half = stride // 2 - 1
    rows = [depth[:, half + i :: stride, half + j :: stride] for i in (0, 1) for j in (0, 1)]
    around = torch.stack(rows)
    low, high = around.amin(0), around.amax(0)
    known = (low > 0) & (high - low < _MAX_DEPTH_SLOPE * pixel_width[:, None, None])
    cells = torch.where(known, around.mean(0), torch.zeros_like(low))
    size = (cells.shape[1], cells.shape[2])
    return DepthTarget(cells, F.adaptive_avg_pool2d(mask, size))


def depth_loss(output: DepthOutput, target: DepthTarget, planes: int) -> Tensor:
    """Smooth L1 loss of a level's depth in units of the spacing of its ``planes`` hypotheses.

    Cells with unknown depth, or depth outside the search range of the level, are ignored.
    """
    half = output.half_range[:, None, None]
    in_range = (target.depth > 0) & ((target.depth - output.center).abs() <= half)
    weight = in_range * (_BACKGROUND + (1 - _BACKGROUND) * target.mask)
    spacing = 2 * half / (planes - 1)
    difference = F.smooth_l1_loss(output.depth / spacing, target.depth / spacing, reduction="none")
    # Each pair counts the same, however little of the object it shows.
    return ((weight * difference).sum((1, 2)) / weight.sum((1, 2)).clamp(min=8)).mean()
