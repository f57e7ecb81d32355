"""Weights files: round trip, and errors for damaged files."""

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from two_view_pose import pose_estimator
from two_view_pose.pose_estimator.methods import OPTIONAL_PARTS, PARTS
from two_view_pose.pose_estimator.networks.container import NetworkConfig, PoseNetworks
from two_view_pose.pose_estimator.networks.weights import (
    exported_state_dict,
    find_weights,
    load_networks,
    read_header,
    read_networks,
    save_weights,
)


def optional(name: str) -> bool:
    return name.startswith(OPTIONAL_PARTS)


def assert_stored(loaded: PoseNetworks, networks: PoseNetworks, stored: dict[str, torch.Tensor]):
    """What was loaded is what was saved, as exactly as each number is stored."""
    before, compared = networks.state_dict(), 0
    for name, tensor in loaded.state_dict().items():
        if name not in stored:
            continue
        error = (tensor - before[name]).abs()
        if stored[name].dtype == torch.int8:
            # 255 steps from the largest number of an output channel to its negative; the step
            # itself is rounded to eight bits.
            largest = before[name].flatten(1).abs().amax(1)
            assert (error.flatten(1).amax(1) <= largest / 127 / 2 * (1 + 2**-8)).all(), name
            compared += 1
        else:
            # Half precision has eleven bits.
            assert (error <= 2**-10 * before[name].abs() + 1e-6).all(), name
    assert compared > 50


@pytest.fixture(scope="module")
def saved(networks: PoseNetworks, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "boxes.safetensors"
    save_weights(networks, path, {"what": "untrained"})
    return path


@pytest.fixture
def damaged(saved: Path, tmp_path: Path) -> Path:
    """A copy to be damaged."""
    path = tmp_path / saved.name
    path.write_bytes(saved.read_bytes())
    path.with_suffix(".json").write_bytes(saved.with_suffix(".json").read_bytes())
    (tmp_path / "boxes_objects").symlink_to(saved.parent / "boxes_objects")
    return path


def change_header(path: Path, **changes: object) -> None:
    header = json.loads(path.with_suffix(".json").read_text())
    path.with_suffix(".json").write_text(json.dumps(header | changes))


def change_tensors(path: Path, **changes: torch.Tensor) -> None:
    tensors = load_file(path)
    path.unlink()
    save_file(tensors | changes, path)


def test_save_and_read_round_trip(saved: Path, networks: PoseNetworks):
    loaded = read_networks(saved)
    assert list(loaded.objects) == ["brick", "crate"]
    assert loaded.config == networks.config and not loaded.training
    for name, model in networks.objects.items():
        assert np.array_equal(loaded.objects[name].keypoints, model.keypoints)
        assert np.array_equal(loaded.objects[name].symmetries, model.symmetries)
    assert_stored(loaded, networks, load_file(saved))
    parameters = sum(p.numel() for n, p in networks.named_parameters() if not optional(n))
    assert saved.stat().st_size < 1.1 * parameters


def test_quantized_networks_have_similar_outputs(saved: Path, networks: PoseNetworks):
    crops = torch.rand(1, 3, 128, 128, generator=torch.Generator().manual_seed(0)) * 255
    with torch.no_grad():
        ours = networks.features(crops, torch.tensor([1])).directions
        theirs = read_networks(saved).features(crops, torch.tensor([1])).directions
    assert float((ours - theirs).abs().max()) < 0.02 * float(ours.abs().max())


def test_saving_read_weights_is_idempotent(complete: Path, tmp_path: Path):
    save_weights(read_networks(complete), tmp_path / "again.safetensors", {})
    assert (tmp_path / "again.safetensors").read_bytes() == complete.read_bytes()


@pytest.mark.parametrize("name", ["detector.head.bias", "features.decoders.0.trunk.0.weight"])
@pytest.mark.parametrize("number", [torch.nan, torch.inf])
def test_saving_nan_raises(boxes, tmp_path: Path, name: str, number: float):
    networks = PoseNetworks(boxes)
    with torch.no_grad():
        networks.state_dict()[name][5] = number
    with pytest.raises(ValueError, match=rf"cannot be stored: NaN.* in {name}$"):
        save_weights(networks, tmp_path / "diverged.safetensors", {})
    assert not list(tmp_path.iterdir())


def test_header_contents(saved: Path):
    header = read_header(saved)
    assert header["what"] == "untrained"
    assert header["objects"]["crate"]["obj_id"] == 7
    assert {"python", "torch"} <= set(header["versions"])
    assert "commit" in header


def test_networks_are_cached(saved: Path):
    assert load_networks(saved) is load_networks(str(saved))


@pytest.fixture(scope="module")
def complete(networks: PoseNetworks, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights with all parts marked as trained."""
    path = tmp_path_factory.mktemp("complete") / "boxes.safetensors"
    trained = networks.trained
    networks.trained = frozenset(PARTS)
    save_weights(networks, path, {"what": "all parts"})
    networks.trained = trained
    return path


def test_load_gives_estimators(complete: Path):
    for method in pose_estimator.METHODS:
        assert pose_estimator.load(method, complete).object_names == ("brick", "crate")
    with pytest.raises(ValueError, match=r"'late-ish'; there are single, .*, mid-pnp, rgbd"):
        pose_estimator.load("late-ish", complete)


@pytest.mark.parametrize(("method", "part"), [("early", "cascade"), ("rgbd", "points")])
def test_missing_part_names_the_training_command(saved: Path, method, part):
    pose_estimator.load("single", saved)
    command = f"generated with --depth: .* train-estimator --stages {part} --init {saved} --data"
    with pytest.raises(ValueError, match=f"lack what '{method}' needs.*'{part}'.*{command}"):
        pose_estimator.load(method, saved)


def test_optional_parts_are_written_if_trained(saved: Path, complete: Path, networks: PoseNetworks):
    assert read_header(saved)["trained"] == []
    assert not [n for n in load_file(saved) if optional(n)]
    assert read_networks(saved).trained == frozenset()
    assert read_header(complete)["trained"] == list(PARTS)
    loaded = read_networks(complete)
    assert loaded.trained == set(PARTS)
    stored = load_file(complete)
    assert exported_state_dict(loaded).keys() <= stored.keys()
    assert_stored(loaded, networks, stored)


def test_only_what_differs_from_shipped_weights_is_written(
    complete: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Also by weights that build on such weights. With another base they are refused."""
    shipped = tmp_path / "shipped"
    shutil.copytree(complete.parent, shipped)
    shutil.copy(complete, shipped / "base.safetensors")
    shutil.copy(complete.with_suffix(".json"), shipped / "base.json")
    monkeypatch.setattr("two_view_pose.pose_estimator.networks.weights.SHIPPED", shipped)
    tuned = read_networks(complete)
    tuned.volume.fine.output.bias.data += 0.5
    changes = shipped / "changes.safetensors"
    save_weights(tuned, changes, {"what": "changes"}, base="base")
    assert set(load_file(changes)) == {"volume.fine.output.bias"}
    assert_stored(read_networks(changes), tuned, load_file(complete))
    tuned.detector.head.bias.data += 0.5
    further = tmp_path / "further.safetensors"
    save_weights(tuned, further, {"what": "more"}, base="changes")
    assert set(load_file(further)) == {"volume.fine.output.bias", "detector.head.bias"}
    assert read_header(further)["base"]["name"] == "base"
    change_tensors(shipped / "base.safetensors", **{"detector.head.bias": torch.zeros(2 + 6)})
    with pytest.raises(ValueError, match="differs from the shipped weights 'base' of another"):
        read_networks(changes)


def test_missing_tensors_of_a_trained_part_raise(damaged: Path):
    change_header(damaged, trained=["detector", "features", "cascade"])
    with pytest.raises(ValueError, match=r"does not fit its header: cascade\."):
        read_networks(damaged)


@pytest.mark.parametrize("trained", [["magic"], "volume", 3, [3], None])
def test_header_with_unknown_parts_raises(damaged: Path, trained):
    change_header(damaged, trained=trained)
    with pytest.raises(ValueError, match=r"trained|does not describe networks"):
        read_networks(damaged)


def test_unknown_names_and_missing_files(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match="no weights named 'nonsense'; shipped weights"):
        find_weights("nonsense")
    with pytest.raises(FileNotFoundError, match="does not exist"):
        find_weights(tmp_path / "none.safetensors")


def test_missing_header_raises(damaged: Path):
    damaged.with_suffix(".json").unlink()
    with pytest.raises(FileNotFoundError, match=r"header .* is missing"):
        read_networks(damaged)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"format": 99}', '"format"'])
def test_invalid_header_raises(damaged: Path, text: str):
    damaged.with_suffix(".json").write_text(text)
    with pytest.raises(ValueError, match="cannot be read"):
        read_networks(damaged)


@pytest.mark.parametrize(
    "changes",
    [
        {"networks": {}},
        {"networks": []},
        {"networks": {"detector": {"color": 3}, "features": {}, "preset": "fast"}},
        {"networks": {"detector": {}, "features": {"width": -4}, "preset": "fast"}},
        {"networks": {"detector": {}, "features": {}, "preset": "slow"}},
        {"objects": []},
        {"objects": {"brick": None}},
        {"objects": {"nothing": {}}},
    ],
)
def test_header_without_networks_raises(damaged: Path, changes: dict):
    change_header(damaged, **changes)
    with pytest.raises(ValueError):
        read_networks(damaged)


@pytest.mark.parametrize("keep", [0, 4, 1000, 1_000_000])
def test_truncated_file_raises(damaged: Path, keep: int):
    damaged.write_bytes(damaged.read_bytes()[:keep])
    with pytest.raises(ValueError, match="is damaged"):
        read_networks(damaged)


def test_flipped_bits_raise(damaged: Path):
    content = bytearray(damaged.read_bytes())
    content[20:40] = bytes(byte ^ 0xFF for byte in content[20:40])
    damaged.write_bytes(bytes(content))
    with pytest.raises(ValueError, match="is damaged"):
        read_networks(damaged)


def test_nan_in_a_file_raises(damaged: Path):
    change_tensors(damaged, **{"detector.head.bias": torch.full((8,), torch.nan)})
    with pytest.raises(ValueError, match="NaN or infinite"):
        read_networks(damaged)


@pytest.mark.parametrize("scale", [None, torch.ones(5), torch.full((64,), torch.nan)])
def test_invalid_scales_raise(damaged: Path, scale: torch.Tensor | None):
    tensors = load_file(damaged)
    name = "features.decoders.0.trunk.0.weight.scale"
    assert tensors.pop(name).shape == (64,)
    if scale is not None:
        tensors[name] = scale
    damaged.unlink()
    save_file(tensors, damaged)
    with pytest.raises(ValueError, match=r"is damaged: (.*trunk.0.weight lacks one scale|.*NaN)"):
        read_networks(damaged)


def test_wrong_shapes_and_unknown_tensors_raise(damaged: Path):
    change_tensors(damaged, **{"detector.head.bias": torch.zeros(9)})
    with pytest.raises(ValueError, match=r"does not fit its header: detector\.head\.bias"):
        read_networks(damaged)
    change_tensors(damaged, **{"detector.head.bias": torch.zeros(8), "extra": torch.zeros(1)})
    with pytest.raises(ValueError, match="more tensors"):
        read_networks(damaged)


def test_weights_of_other_objects_raise(damaged: Path):
    header = read_header(damaged)
    change_header(damaged, objects={"brick": header["objects"]["brick"]})
    with pytest.raises(ValueError, match="does not fit its header"):
        read_networks(damaged)


class _Bomb:
    def __reduce__(self) -> tuple:
        return (pytest.fail, ("a pickle was executed",))


def test_a_pickle_is_not_executed(damaged: Path):
    damaged.write_bytes(pickle.dumps(_Bomb()))
    with pytest.raises(ValueError, match="is damaged"):
        read_networks(damaged)


def test_unknown_preset_raises(boxes):
    with pytest.raises(ValueError, match="unknown preset 'slow'; there are fast, features, paper"):
        PoseNetworks(boxes, NetworkConfig(preset="slow"))
