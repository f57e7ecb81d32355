"""Decoders of objects: initialized from the shared one, each trained by its object alone."""

import pytest
import torch
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.features import FeatureConfig, KeypointNet
from two_view_pose.pose_estimator.networks.weights import read_networks, save_weights
from two_view_pose.pose_estimator.training.stages import DecoderStage, FeatureStage
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet


@pytest.fixture
def net() -> KeypointNet:
    torch.manual_seed(0)
    return KeypointNet(3, FeatureConfig(crop=64)).eval()


def crops(count: int) -> torch.Tensor:
    return torch.rand(count, 3, 64, 64) * 255


@torch.no_grad()
def test_splitting_and_sharing_keep_the_outputs(net):
    images, objects = crops(5), torch.tensor([2, 0, 1, 0, 2])
    before = net(images, objects)
    net.split_decoders()
    assert net.config.own_decoders and len(net.decoders) == 3
    for old, new in zip(before, net(images, objects), strict=True):
        torch.testing.assert_close(new, old, atol=1e-4, rtol=1e-4)
    net.share_decoders()
    assert not net.config.own_decoders and len(net.decoders) == 1
    for old, new in zip(before, net(images, objects), strict=True):
        torch.testing.assert_close(new, old, atol=1e-4, rtol=1e-4)


@torch.no_grad()
def test_mixed_batch_equals_single_crops(net):
    net.split_decoders()
    for decoder in net.decoders:
        for parameter in decoder.parameters():
            parameter += 0.05 * torch.randn_like(parameter)
    images, objects = crops(5), torch.tensor([2, 0, 1, 0, 2])
    together = net(images, objects)
    for row in range(5):
        alone = net(images[row : row + 1], objects[row : row + 1])
        for mixed, own in zip(together, alone, strict=True):
            torch.testing.assert_close(mixed[row : row + 1], own, atol=1e-3, rtol=1e-3)
    assert not torch.allclose(together.decoder[1], together.decoder[3])


@pytest.fixture
def stage(pack, boxes) -> DecoderStage:
    torch.manual_seed(0)
    networks = PoseNetworks(boxes)
    training = TrainingSet(pack, boxes, networks.config.features)
    return DecoderStage(networks, training, training, steps=8, batch=3, learning_rate=1.0, seed=0)


def test_batch_trains_only_its_objects_decoder(stage):
    batches = list(stage.batches(0))
    asked = [set(batch["object"].tolist()) for batch in batches]
    assert all(len(objects) == 1 for objects in asked) and len(set.union(*asked)) == 2
    batch, (number,) = batches[0], asked[0]
    loss, _ = stage.loss(batch)
    loss.backward()
    features = stage.networks.features
    used, other = features.decoders[number], features.decoders[1 - number]
    assert used.trunk[0].weight.grad.abs().sum() > 0
    assert all(p.grad is None for p in other.parameters())
    assert all(p.grad is None for p in features.encoder.parameters())
    assert not features.head_weight.grad[1 - number].any()


def test_tune_encoder_trains_unfrozen_stages(stage):
    networks = PoseNetworks(dict(zip(("brick", "crate"), stage.train.models, strict=True)))
    networks.features.encoder.freeze(2)
    tuned = DecoderStage(
        networks, stage.train, stage.train, steps=1, batch=3, learning_rate=1.0, seed=0,
        tune_encoder=True,
    )  # fmt: skip
    loss, _ = tuned.loss(next(tuned.batches(0)))
    loss.backward()
    encoder = networks.features.encoder
    assert encoder.stages[5][0].expand.weight.grad.abs().sum() > 0
    assert encoder.stages[0][0].project.weight.grad is None  # frozen stages stay so


def test_resumed_batches_are_identical(stage):
    third, resumed = list(stage.batches(0))[2], next(stage.batches(2))
    assert all(torch.equal(third[name], resumed[name]) for name in third)


def test_weights_with_own_decoders_round_trip(stage, tmp_path):
    with torch.no_grad():
        stage.networks.features.decoders[1].trunk[0].weight.fill_(0.25)
    save_weights(stage.networks, tmp_path / "own.safetensors", {})
    read = read_networks(tmp_path / "own.safetensors")
    assert read.config.features.own_decoders
    assert torch.allclose(read.features.decoders[1].trunk[0].weight, torch.tensor(0.25), rtol=4e-3)
    assert read.features.decoders[0].trunk[0].weight.std() > 1e-3


def test_feature_stage_shares_the_decoder(stage):
    networks = stage.networks
    FeatureStage(networks, stage.train, stage.train, steps=1, batch=1, learning_rate=1.0, seed=0)
    assert not networks.config.features.own_decoders
