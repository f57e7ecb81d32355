"""Transfer of weights of other objects: shared objects keep their outputs, new ones are listed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from two_view_pose.pose_estimator.methods import PARTS
from two_view_pose.pose_estimator.networks.container import NetworkConfig, PoseNetworks
from two_view_pose.pose_estimator.networks.weights import save_weights
from two_view_pose.pose_estimator.training.config import TrainEstimatorConfig
from two_view_pose.pose_estimator.training.train_estimator import start_from
from two_view_pose.pose_estimator.training.transfer import transfer_weights


@pytest.fixture(scope="module")
def three(boxes) -> PoseNetworks:
    """Networks that know crate, brick and another object, in this order."""
    torch.manual_seed(1)
    slab = replace(boxes["brick"], name="slab", keypoints=boxes["brick"].keypoints * 1.5)
    networks = PoseNetworks({"crate": boxes["crate"], "brick": boxes["brick"], "slab": slab})
    for parameter in networks.parameters():
        torch.nn.init.normal_(parameter.data, std=0.05)
    networks.trained = frozenset({"detector", "features", "volume"})
    return networks.eval()


@pytest.fixture
def fresh(boxes) -> PoseNetworks:
    """Untrained networks for the two boxes."""
    torch.manual_seed(2)
    return PoseNetworks(boxes)


def test_shared_objects_keep_their_outputs(three, fresh, boxes):
    transfer = transfer_weights(three, fresh)
    assert transfer.known == ("brick", "crate") and not transfer.new and not transfer.incomplete
    assert fresh.trained == three.trained
    fresh.eval()
    images = torch.rand(1, 3, 240, 320, generator=torch.Generator().manual_seed(0)) * 255
    with torch.no_grad():
        for name in boxes:
            mine, theirs = fresh.index[name], three.index[name]
            ours, before = (
                n.features(images[..., :128, :128], torch.tensor([i]))
                for n, i in ((fresh, mine), (three, theirs))
            )
            assert all(torch.allclose(a, b, atol=1e-4) for a, b in zip(ours, before, strict=True))
            for a, b in zip(fresh.detector(images), three.detector(images), strict=True):
                assert torch.allclose(a[:, mine], b[:, theirs], atol=1e-4)


def test_a_new_object_keeps_its_initial_weights(three, boxes):
    torch.manual_seed(3)
    # Another object with a known name.
    other = replace(boxes["crate"], keypoints=boxes["crate"].keypoints + 0.01)
    networks = PoseNetworks({"brick": boxes["brick"], "crate": other})
    row = networks.features.head_weight[1].clone()
    transfer = transfer_weights(three, networks)
    assert transfer.known == ("brick",) and transfer.new == ("crate",)
    assert transfer.incomplete == ("detector", "features")
    assert networks.trained == {"volume"}
    assert torch.equal(networks.features.head_weight[1], row)
    assert torch.equal(networks.features.head_weight[0], three.features.head_weight[1])
    ours, theirs = (n.features.decoders[0].trunk[0].weight for n in (networks, three))
    assert torch.equal(ours, theirs)
    assert "new: crate in detector, features; known before: brick" in str(transfer)


def test_own_decoders_follow_their_objects(three, boxes):
    torch.manual_seed(4)
    three.features.split_decoders()
    for number, decoder in enumerate(three.features.decoders):
        torch.nn.init.constant_(decoder.trunk[0].weight, float(number))
    names = list(three.objects)
    other = replace(boxes["crate"], keypoints=boxes["crate"].keypoints + 0.01)
    networks = PoseNetworks({"crate": other, "brick": boxes["brick"]})
    transfer = transfer_weights(three, networks)
    assert networks.config.features.own_decoders and transfer.new == ("crate",)
    assert "features" in transfer.incomplete
    new, brick = (decoder.trunk[0].weight for decoder in networks.features.decoders)
    assert torch.all(brick == names.index("brick"))
    assert torch.all(new == 1.0)  # the mean of 0, 1 and 2
    # And back to a shared decoder, if that is what the weights have.
    transfer_weights(PoseNetworks(boxes), networks)
    assert not networks.config.features.own_decoders and len(networks.features.decoders) == 1


def test_every_tensor_that_depends_on_the_objects_is_loaded(three, fresh):
    """A tensor missing from the list would be rejected: it has another number of rows."""
    three.trained = frozenset(PARTS)
    try:
        transfer = transfer_weights(three, fresh)
    finally:
        three.trained = frozenset({"detector", "features", "volume"})
    assert transfer.parts == PARTS and fresh.trained == set(PARTS)
    small, large = fresh.state_dict(), three.state_dict()
    for name, tensor in small.items():
        if tensor.shape == large[name].shape and ".decoders." not in name:
            assert torch.equal(tensor, large[name]), name
    depending = [name for name in small if small[name].shape != large[name].shape]
    assert {name.split(".")[0] for name in depending} == {"detector", "features", "points"}


def test_a_volume_of_another_preset_is_a_start(three, boxes):
    """Its layers are copied, of the first one what reads features and not votes."""
    networks = PoseNetworks(boxes, NetworkConfig(preset="features"))
    transfer = transfer_weights(three, networks)
    assert transfer.adapted == ("volume",) and networks.trained == {"detector", "features"}
    assert "of another preset, to be trained: volume" in str(transfer)
    for mine, theirs in (
        (networks.volume.coarse, three.volume.coarse),
        (networks.volume.fine, three.volume.fine),
    ):
        assert torch.equal(mine.output.weight, theirs.output.weight)
        assert torch.equal(mine.trunk[0].weight, theirs.trunk[0].weight[:, :64])
    three_again = PoseNetworks(three.objects, three.config)
    networks.trained = frozenset({"detector", "features", "volume"})
    transfer_weights(networks, three_again)
    first = three_again.volume.fine.trunk[0].weight
    assert torch.equal(first[:, :64], networks.volume.fine.trunk[0].weight)
    assert not first[:, 64:].any()


def test_untrained_parts_are_not_loaded(three, fresh):
    three.trained = frozenset({"features"})
    try:
        assert transfer_weights(three, fresh).parts == ("features",)
    finally:
        three.trained = frozenset({"detector", "features", "volume"})
    assert not torch.equal(fresh.detector.head.weight[0], three.detector.head.weight[1])


def test_networks_of_another_shape_are_rejected(three, boxes):
    config = replace(three.config, features=replace(three.config.features, width=32))
    with pytest.raises(ValueError, match="networks of another shape"):
        transfer_weights(three, PoseNetworks(boxes, config))


@pytest.mark.slow
def test_new_objects_must_be_trained(three, boxes, tmp_path: Path, capsys):
    weights = tmp_path / "three.safetensors"
    save_weights(three, weights, {"what": "test"})
    bracket = replace(boxes["brick"], name="bracket")
    networks = PoseNetworks({"brick": boxes["brick"], "bracket": bracket})
    config = TrainEstimatorConfig(
        data=tmp_path, out=tmp_path / "out", init=str(weights), stages=("features", "volume")
    )
    with pytest.raises(
        ValueError,
        match="know crate, brick, slab, and the training asks for brick, bracket: add detector to "
        "--stages, which must learn bracket",
    ):
        start_from(config, networks)
    start_from(replace(config, stages=PARTS[:2]), networks)
    # The default stages train the new object on the 2D features.
    start_from(replace(config, stages=()), networks)
    assert "loaded: detector, features, volume" in capsys.readouterr().out


@pytest.mark.slow
def test_decoders_need_features_to_build_on(three, boxes, tmp_path: Path):
    three.trained = frozenset({"detector"})
    try:
        save_weights(three, tmp_path / "half.safetensors", {})
    finally:
        three.trained = frozenset({"detector", "features", "volume"})
    networks = PoseNetworks({"brick": boxes["brick"]})
    config = TrainEstimatorConfig(tmp_path, tmp_path, init=str(tmp_path / "half.safetensors"))
    with pytest.raises(ValueError, match=r"no trained 2D features .* add features to --stages"):
        start_from(config, networks)
    start_from(replace(config, stages=("features", "decoders")), networks)
