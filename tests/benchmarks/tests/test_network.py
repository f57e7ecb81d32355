"""The operations of the 3D network are counted as torch counts them."""

import pytest
import torch
from benchmarks.config import BenchConfig
from benchmarks.groups.metrics import measure
from benchmarks.groups.network import volume_flops, volume_run
from torch.utils.flop_counter import FlopCounterMode
from two_view_pose.core.results import check_record
from two_view_pose.pose_estimator.networks.features import FeatureConfig
from two_view_pose.pose_estimator.networks.volume import PRESETS, Volume


@pytest.mark.parametrize("preset", ["fast", "paper"])
def test_operations_are_those_that_torch_counts(preset):
    volume = Volume(FeatureConfig().volume_channels, PRESETS[preset]).eval()
    inputs = volume.trunk[0].in_channels
    counter = FlopCounterMode(display=False)
    with counter, torch.no_grad():
        volume.output(volume.trunk(torch.zeros(1, inputs, 6, 6, 6)))
    assert volume_flops(preset, 6) == counter.get_total_flops()


def test_a_run_gives_nine_maps():
    assert tuple(volume_run("fast", 5, 2)().shape) == (2, 9, 5, 5, 5)


def test_add_s_of_both_sides_agrees():
    (record,) = map(check_record, measure(BenchConfig(repeats=1), count=100))
    assert record["largest_difference"] < 1e-12 and record["goal"] == 3.0
