"""Checkpoints round-trip, and a failed save keeps the old one."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import nn
from two_view_pose.core.errors import InputError
from two_view_pose.pose_estimator.training.checkpoints import (
    load_checkpoint,
    read_counters,
    save_checkpoint,
)


def network(value: float, width: int = 3) -> nn.Module:
    """A layer and a batch norm, which has a buffer of whole numbers."""
    net = nn.Sequential(nn.Linear(width, 2), nn.BatchNorm1d(2))
    for parameter in net.parameters():
        nn.init.constant_(parameter, value)
    net[1].num_batches_tracked += round(10 * value)
    return net


def test_checkpoint_round_trip(tmp_path: Path):
    path = tmp_path / "features.safetensors"
    state = {"optimizer.0.weight.exp_avg": torch.arange(6.0).reshape(2, 3).T}
    save_checkpoint(path, network(0.5), state, {"step": 12})
    net = network(0.1)
    kept = load_checkpoint(net, path)
    assert kept.keys() == state.keys() and read_counters(path) == {"step": 12}
    assert all(torch.equal(kept[name], tensor) for name, tensor in state.items())
    expected = network(0.5).state_dict()
    assert all(torch.equal(net.state_dict()[name], t) for name, t in expected.items())


def test_networks_of_another_shape_are_rejected(tmp_path: Path):
    save_checkpoint(tmp_path / "a.safetensors", network(0.5), {}, {"step": 1})
    with pytest.raises(ValueError, match="networks of another shape; give another --out"):
        load_checkpoint(network(0.5, width=4), tmp_path / "a.safetensors")


def test_a_failed_save_keeps_the_old_checkpoint(tmp_path: Path, monkeypatch):
    path = tmp_path / "features.safetensors"
    save_checkpoint(path, network(0.5), {}, {"step": 1})
    before = path.read_bytes()

    def broken(self: Path, target: Path) -> Path:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "replace", broken)
    with pytest.raises(OSError, match="disk full"):
        save_checkpoint(path, network(0.7), {}, {"step": 2})
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("damage", ["truncated", "step", "negative", "nan"])
def test_damaged_checkpoints_are_refused_by_name(tmp_path: Path, damage: str):
    path, net = tmp_path / "features.safetensors", network(0.5)
    if damage == "nan":
        nn.init.constant_(net[0].bias, torch.nan)
    step = {"step": "x", "negative": -1}.get(damage, 7)
    save_checkpoint(path, net, {}, {"step": step})  # type: ignore[dict-item]
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match=r"features\.safetensors is damaged.*delete it"):
        load_checkpoint(network(0.1), path)
        read_counters(path)


def test_missing_counters_are_refused(tmp_path: Path):
    path = tmp_path / "features.safetensors"
    save_checkpoint(path, network(0.5), {}, {"step": 7})
    with pytest.raises(InputError, match=r"features\.safetensors is damaged"):
        read_counters(path, "averaged")
