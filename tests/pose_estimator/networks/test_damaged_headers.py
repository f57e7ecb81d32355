"""Headers of weights that no networks have are refused by name, before they fill the memory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from two_view_pose.core.errors import InputError
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.weights import read_networks, save_weights


@pytest.fixture
def saved(networks: PoseNetworks, tmp_path: Path) -> Path:
    path = tmp_path / "boxes.safetensors"
    save_weights(networks, path, {"what": "untrained"})
    return path


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("detector", "channels", 10**6),
        ("detector", "channels", "64"),
        ("detector", "roi_scale", 0),
        ("features", "stride", 0),
        ("features", "crop", 100),
        ("features", "width", 60),
        ("features", "width", 2.5),
        ("features", "own_decoders", 2),
        ("features", "roi_scale", float("nan")),
    ],
)
def test_impossible_shapes_are_refused(saved: Path, part: str, name: str, value: Any) -> None:
    path = saved.with_suffix(".json")
    header = json.loads(path.read_text())
    header["networks"][part][name] = value
    path.write_text(json.dumps(header))
    with pytest.raises(InputError, match=r"boxes\.safetensors does not (describe|fit)"):
        read_networks(saved)


@pytest.mark.parametrize(
    "change", [{"trained": ["magic"]}, {"base": {}}, {"base": 3}, {"objects": {"brick": {}}}]
)
def test_other_fields_are_refused_by_name(saved: Path, change: dict) -> None:
    path = saved.with_suffix(".json")
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=r"boxes\.safetensors"):
        read_networks(saved)


def test_endless_nesting_is_refused(saved: Path) -> None:
    saved.with_suffix(".json").write_text("[" * 100_000)
    with pytest.raises(InputError, match=r"boxes\.json cannot be read"):
        read_networks(saved)
