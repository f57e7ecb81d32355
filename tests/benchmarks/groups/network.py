"""Efficiency of Mid-Fusion's 3D network, relative to the processor's matrix products.

The reference is the best large matrix product on the same cores and in the same precision: bfloat16
where the CPU multiplies it in hardware, else float32, as the estimator chooses too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from two_view_pose.core.device import has_fast_bfloat16
from two_view_pose.core.processor import number_format
from two_view_pose.pose_estimator.networks.features import FeatureConfig
from two_view_pose.pose_estimator.networks.fused import fused
from two_view_pose.pose_estimator.networks.volume import PRESETS, Volume, VolumeNet, to_conv_layout

from ..config import BenchConfig
from ..stopwatch import WARM_UP, Record, seconds

GOAL = 0.5
"""Fraction of the matrix product's operations per second."""

PRODUCT_SIZES = (1024, 2048, 4096)
"""Sides of the matrices; which of them is quickest depends on the processor."""

_RUNS = 4
"""Runs in a row after the first of a turn."""

PAPER_CELLS = 60
"""Voxels along a side of the paper's coarse volume."""


def measure(config: BenchConfig) -> Iterator[Record]:
    """The 3D network of both presets against a matrix product.

    ``fast`` runs both of its volumes, with one pair of views and with eight; ``paper`` its coarse
    one. A run is the trunk and the output layer, without what lifts the features.
    """
    fast = PRESETS["fast"]
    sides = [level.cells for level in (fast.coarse, fast.fine) if level.cells is not None]
    cells = " and ".join(f"{side}^3" for side in sides)
    for pairs, said in ((1, "1 pair"), (8, "8 pairs")):
        work = f"3D network, fast ({cells}), {said}"
        yield compare_with_product(work, "fast", sides, pairs, config.repeats)
    work = f"3D network, paper ({PAPER_CELLS}^3), 1 pair"
    yield compare_with_product(work, "paper", [PAPER_CELLS], 1, config.fewer_repeats)


def compare_with_product(
    work: str,
    preset: str,
    sides: list[int],
    batch: int,
    repeats: int,
    sizes: tuple[int, ...] = PRODUCT_SIZES,
) -> Record:
    """One way to run the 3D network against the quickest of some matrix products.

    Each side's turn is several runs in a row. The first finds the caches full of what the other
    side left there, and is reported separately: this is the network's case in an estimate.

    Args:
        work: what to call it.
        preset: whose network.
        sides: voxels along a side of each volume that is run.
        batch: samples in each.
        repeats: timed repeats.
        sizes: sides of the matrices.

    Returns:
        A record of the results file: the ratio of operations in a second;
        ``value_after_other_work`` is that of first runs.
    """
    runs = [volume_run(preset, side, batch) for side in sides]
    products = [matrix_product(size) for size in sizes]
    works: list[Callable[[], Any]] = [lambda: [run() for run in runs], *products]
    rounds = [[_row_of_runs(work) for work in works] for _ in range(repeats + WARM_UP)]
    first = float(np.median([row[0][0] for row in rounds[WARM_UP:]]))
    medians = np.median([[later for _, later in row] for row in rounds[WARM_UP:]], axis=0)
    flops = sum(batch * volume_flops(preset, side) for side in sides)
    ours = flops / medians[0]
    peaks = 2 * np.array(sizes, dtype=float) ** 3 / medians[1:]
    best = int(peaks.argmax())
    return {
        "metric": "ratio",
        "value": ours / peaks[best],
        "unit": "",
        "work": work,
        "against": f"{number_format()} matrix product of {sizes[best]}",
        "goal": GOAL,
        "value_after_other_work": float(flops / first / peaks[best]),
        "flops": float(flops),
        "flops_per_second": float(ours),
        "flops_per_second_against": float(peaks[best]),
        "seconds": float(medians[0]),
        "seconds_against": float(medians[1 + best]),
        "threads": torch.get_num_threads(),
        "n": repeats,
    }


def _row_of_runs(work: Callable[[], Any]) -> tuple[float, float]:
    """Seconds of the first of some runs, and the median of the others."""
    first, *others = (seconds(work) for _ in range(1 + _RUNS))
    return first, float(np.median(others))


def volume_flops(preset: str, side: int) -> int:
    """Operations (two for a multiply-add) of the 3D convolutions of a volume of one sample.

    Args:
        preset: whose network.
        side: voxels along a side; what multiplies the zeros around them counts as well.
    """
    volume = Volume(FeatureConfig().volume_channels, PRESETS[preset])
    convolutions = [m for m in volume.modules() if isinstance(m, nn.Conv3d)]
    return 2 * side**3 * sum(conv.weight.numel() for conv in convolutions)


def volume_run(preset: str, side: int, batch: int) -> Callable[[], Tensor]:
    """What runs trunk and output of a preset's volume as the estimator does; random weights.

    Args:
        preset: whose network.
        side: voxels along a side.
        batch: samples.

    Returns:
        A function that gives (batch, 9, side, side, side).
    """
    torch.manual_seed(0)
    bfloat16 = has_fast_bfloat16()
    plain = VolumeNet(FeatureConfig().volume_channels, PRESETS[preset]).eval()
    plain.to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]
    first = next(m for m in plain.coarse.trunk if isinstance(m, nn.Conv3d))
    with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
        x = to_conv_layout(torch.randn(batch, first.in_channels, side, side, side))
    network: Any = fused(plain, torch.bfloat16 if bfloat16 else torch.float32)

    def run() -> Tensor:
        with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
            return network.coarse.output(network.coarse.trunk(x))

    return run


def matrix_product(size: int) -> Callable[[], Tensor]:
    """What multiplies two square matrices in the estimator's precision."""
    torch.manual_seed(0)
    dtype = torch.bfloat16 if has_fast_bfloat16() else torch.float32
    a, b = torch.randn(2, size, size).to(dtype)

    def run() -> Tensor:
        with torch.inference_mode():
            return a @ b

    return run
