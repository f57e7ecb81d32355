"""The training of ``early``'s cascade: pairs of crops with depth, on top of frozen 2D features."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from ..networks.cascade import CascadeViews, DepthOutput, half_range
from ..training_data.dataset import TrainingSet
from ..training_data.target_sample import arrays_of_pair, as_input
from .loader import Batch, Draw, Sample
from .stage_base import FrozenFeatureStage

_LEVEL_WEIGHTS = (0.5, 1.0, 2.0)
"""Of the levels' losses, as Cas-MVSNet has them."""

_BACKGROUND = 0.1
"""How much a pixel beside the object counts."""

_MAX_DEPTH_SLOPE = 6.0
"""Widths of a crop pixel by which the depths of neighbors may differ; at an edge there is no depth
to learn. A packed crop repeats pixels, so a slope may rise by two at once."""

_GUESS_NOISE = 0.25
"""Standard deviation of the guess of the center's depth, in half ranges: the surface, which is at
most half a diameter from the center, is to stay in the range."""

_MAX_GUESS_ERROR = 0.5


class Truth(NamedTuple):
    """What a stage's map should be.

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

    def drawing(self, *, held_out: bool = False) -> Draw:
        return partial(draw_guessed_pair, self.held_out if held_out else self.train)

    def forward(self, batch: Batch) -> tuple[list[DepthOutput], list[Truth]]:
        """Runs a batch of pairs of :func:`draw_guessed_pair`.

        Returns:
            What each stage says, and what it should say.
        """
        networks = self.networks
        networks.features.eval()
        diameter, distance = self.diameters[batch["object"]], batch["T_cam_obj"][:, 2, 3]
        count = len(diameter)
        reach = half_range(networks.cascade.config.levels[0], diameter)
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
                distance + batch["guess_error"] * reach,
                diameter,
            )
        focal = torch.linalg.det(batch["K"][:, 0, :2, :2]).abs().sqrt()
        truths = [
            true_cells(batch["depth"], batch["mask"], output.stride, distance / focal)
            for output in outputs
        ]
        return outputs, truths

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        self.networks.cascade.train()
        outputs, truths = self.forward(batch)
        total = torch.zeros((), device=self.device)
        numbers: dict[str, Tensor] = {}
        names = ("coarse", "middle", "fine")
        levels = self.networks.cascade.config.levels
        for name, weight, level, output, truth in zip(
            names, _LEVEL_WEIGHTS, levels, outputs, truths, strict=True
        ):
            part = depth_loss(output, truth, level.planes)
            total = total + weight * part
            numbers[name] = part
        return total, numbers

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Absolute error of the depth on the object in millimeters: median and 80th percentile."""
        self.networks.cascade.eval()
        errors = []
        for batch in self.held_out_batches():
            outputs, truths = self.forward(batch)
            on_object = (truths[-1].depth > 0) & (truths[-1].mask > 0.5)
            errors.append((outputs[-1].depth - truths[-1].depth)[on_object].abs())
        error = 1000 * torch.cat(errors).cpu().numpy()
        return {
            "depth_error_mm": float(np.median(error)),
            "depth_error_mm_p80": float(np.quantile(error, 0.8)),
        }


def draw_guessed_pair(source: TrainingSet, rng: np.random.Generator) -> Sample:
    """A pair, the depth of its first view, and a guess of its center's depth."""
    first, second, T_second_ref = source.draw_pair(rng)
    error = np.clip(rng.normal(0, _GUESS_NOISE), -_MAX_GUESS_ERROR, _MAX_GUESS_ERROR)
    return {
        **arrays_of_pair(first, second),
        "mask": first.mask,
        "depth": first.depth,
        "T_second_ref": T_second_ref.astype(np.float32),
        "guess_error": np.float32(error),
    }


def true_cells(depth: Tensor, mask: Tensor, stride: int, pixel_width: Tensor) -> Truth:
    """The truth on a grid of cells.

    Args:
        depth: (B, S, S) of a crop, m, 0 where unknown.
        mask: (B, G, G) covered fraction by the visible object.
        stride: pixels of the crop per cell, even.
        pixel_width: (B,) of the crop's pixels where the object is, m.

    Returns:
        The mean depth of the four pixels around each cell's center, where all are known and none
        is across an edge, and the mask on the same grid.
    """
    half = stride // 2 - 1
    rows = [depth[:, half + i :: stride, half + j :: stride] for i in (0, 1) for j in (0, 1)]
    around = torch.stack(rows)
    low, high = around.amin(0), around.amax(0)
    known = (low > 0) & (high - low < _MAX_DEPTH_SLOPE * pixel_width[:, None, None])
    cells = torch.where(known, around.mean(0), torch.zeros_like(low))
    size = (cells.shape[1], cells.shape[2])
    return Truth(cells, F.adaptive_avg_pool2d(mask, size))


def depth_loss(output: DepthOutput, truth: Truth, planes: int) -> Tensor:
    """Smooth L1 loss of one stage's depth in units of its spacing, mostly on the object.

    Cells whose depth is unknown, or out of the range that the stage searched, do not count.

    Args:
        output: of the stage.
        truth: on its grid.
        planes: how many depth hypotheses it had.
    """
    half = output.half_range[:, None, None]
    in_range = (truth.depth > 0) & ((truth.depth - output.center).abs() <= half)
    weight = in_range * (_BACKGROUND + (1 - _BACKGROUND) * truth.mask)
    spacing = 2 * half / (planes - 1)
    difference = F.smooth_l1_loss(
        output.depth / spacing, truth.depth / spacing, reduction="none", beta=1.0
    )
    # Each pair counts the same, however little of the object it shows.
    return ((weight * difference).sum((1, 2)) / weight.sum((1, 2)).clamp(min=8)).mean()
