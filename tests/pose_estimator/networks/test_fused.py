import pytest
import torch
from torch import nn
from two_view_pose.core.device import has_fast_bfloat16
from two_view_pose.pose_estimator.networks.decoder import ConvBlock
from two_view_pose.pose_estimator.networks.detector import Detector
from two_view_pose.pose_estimator.networks.encoder import Encoder, SameConv
from two_view_pose.pose_estimator.networks.features import FeatureConfig, KeypointNet
from two_view_pose.pose_estimator.networks.fused import FusedConv, can_fuse, can_fuse_in, fused
from two_view_pose.pose_estimator.networks.volume import PRESETS, Volume

pytestmark = pytest.mark.skipif(not can_fuse(), reason="this torch has no oneDNN")
needs_bfloat16 = pytest.mark.skipif(
    not can_fuse_in(torch.bfloat16),
    reason="oneDNN refuses bfloat16 here: the processor has no AVX-512, or is told to use none",
)


def randomized(module: nn.Module, seed: int = 0) -> nn.Module:
    """The module in evaluation mode, with random batch norm statistics."""
    generator = torch.Generator().manual_seed(seed)
    for layer in module.modules():
        if isinstance(layer, nn.BatchNorm2d | nn.BatchNorm3d):
            for tensor in (layer.running_mean, layer.bias.data):
                tensor.copy_(torch.randn(tensor.shape, generator=generator) * 0.3)
            for tensor in (layer.running_var, layer.weight.data):
                tensor.copy_(torch.rand(tensor.shape, generator=generator) + 0.5)
    return module.eval()


@pytest.mark.parametrize("kernel", [3, 5])
@pytest.mark.parametrize("side", [16, 20])
def test_fused_same_padding_matches_tensorflow(kernel, side):
    conv = SameConv(4, 4, kernel, 2, groups=4)
    x = torch.randn(2, 4, side, side)
    with torch.no_grad():
        assert torch.allclose(FusedConv(conv, torch.float32)(x), conv(x), atol=1e-5)
        clipped = FusedConv(conv, torch.float32).relu6(8 * x)
        assert torch.allclose(clipped, conv.relu6(8 * x), atol=1e-5)
    assert clipped.min() >= 0 and clipped.max() <= 6 and (clipped == 6).any()


@pytest.mark.parametrize(
    "network, inputs",
    [
        (Encoder(6), (torch.rand(2, 3, 64, 64) * 255,)),
        (ConvBlock(8, 16), (torch.randn(2, 8, 9, 9),)),
        (Detector(3), (torch.rand(1, 3, 240, 320) * 255,)),
        (
            KeypointNet(3, FeatureConfig(own_decoders=True)),
            (torch.rand(3, 3, 128, 128) * 255, torch.tensor([2, 0, 2])),
        ),
        (Volume(32, PRESETS["fast"]).trunk, (torch.randn(1, 82, 6, 6, 6),)),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, nn.Module) else "",
)
@torch.no_grad()
def test_fused_network_matches_the_original(network, inputs):
    network = randomized(network)
    quick = fused(network, torch.float32)
    assert any(isinstance(layer, FusedConv) for layer in quick.modules())
    assert not any(isinstance(layer, nn.BatchNorm2d | nn.BatchNorm3d) for layer in quick.modules())

    def flat(answer):
        return [answer] if isinstance(answer, torch.Tensor) else list(answer)

    for ours, theirs in zip(flat(quick(*inputs)), flat(network(*inputs)), strict=True):
        assert ours.shape == theirs.shape
        assert torch.allclose(ours, theirs, atol=1e-3 * float(theirs.abs().max()) + 1e-6)


@needs_bfloat16
@torch.no_grad()
def test_bfloat16_is_close():
    network = randomized(ConvBlock(8, 16))
    x = torch.randn(2, 8, 9, 9)
    answer = fused(network, torch.bfloat16)(x)
    assert answer.dtype == torch.bfloat16
    assert torch.allclose(answer.float(), network(x), atol=0.05) and not torch.equal(
        answer.float(), network(x)
    )


@pytest.mark.parametrize(
    "dtype", [pytest.param(torch.bfloat16, marks=needs_bfloat16), torch.float32]
)
@torch.inference_mode()
def test_cached_layouts_do_not_change_outputs(dtype):
    """The first call fixes the layout; batches and sizes may change after it."""
    network = randomized(Encoder(6))
    images = [torch.rand(batch, 3, side, side) for batch, side in ((1, 64), (3, 64), (2, 96))]
    alone = [fused(network, dtype)(255 * image) for image in images]
    quick = fused(network, dtype)
    for image, first in zip([*images, *images], [*alone, *alone], strict=True):
        assert all(map(torch.equal, quick(255 * image), first))


def test_original_network_is_unchanged():
    network = randomized(Encoder(2))
    before = [type(layer) for layer in network.modules()]
    fused(network, torch.bfloat16)
    assert [type(layer) for layer in network.modules()] == before
    assert all(p.dtype == torch.float32 for p in network.parameters())


def test_can_fuse_in_float32_without_random_numbers():
    torch.manual_seed(0)
    expected = torch.rand(1)
    torch.manual_seed(0)
    can_fuse_in.cache_clear()
    assert can_fuse_in(torch.float32)
    assert torch.equal(torch.rand(1), expected)


def test_bfloat16_is_used_only_if_it_can_be_fused():
    assert not has_fast_bfloat16() or can_fuse_in(torch.bfloat16)
