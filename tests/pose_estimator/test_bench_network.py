"""The operations of the 3D network are counted as torch counts them."""

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode
from two_view_pose.pose_estimator.bench_metrics import compare_add_s
from two_view_pose.pose_estimator.bench_network import (
    compare_with_product,
    volume_flops,
    volume_run,
)
from two_view_pose.pose_estimator.features import FeatureConfig
from two_view_pose.pose_estimator.results import check_record
from two_view_pose.pose_estimator.volume import PRESETS, Volume


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


def test_a_record_is_a_ratio_of_operations_in_a_second():
    record = check_record(compare_with_product("a volume", "fast", [4, 6], 2, 1, sizes=(32, 64)))
    assert record["flops"] == 2 * (volume_flops("fast", 4) + volume_flops("fast", 6))
    assert record["flops_per_second"] == pytest.approx(record["flops"] / record["seconds"])
    against = record["flops_per_second_against"]
    assert record["value"] == pytest.approx(record["flops_per_second"] / against)
    assert record["against"].split()[-1] in ("32", "64") and record["goal"] == 0.5


def test_add_s_record(boxes):
    record = check_record(compare_add_s(boxes, repeats=1, seed=0, count=100))
    assert record["largest_difference"] < 1e-12 and record["goal"] == 3.0
