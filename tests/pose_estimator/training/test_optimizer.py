"""Muon on views of the filters, AdamW on the rest: both update the parameters in place."""

import pytest
import torch
from torch import nn
from two_view_pose.pose_estimator.training import optimizer
from two_view_pose.pose_estimator.training.optimizer import Float32Muon, HybridOptimizer


def network(memory_format: torch.memory_format) -> nn.Sequential:
    torch.manual_seed(0)
    net = nn.Sequential(
        nn.Conv2d(16, 24, 3, bias=False), nn.BatchNorm2d(24), nn.ReLU(), nn.Conv2d(24, 2, 1)
    )
    return net.to(memory_format=memory_format)


def train(net: nn.Module, optimizer: HybridOptimizer, first: int, last: int) -> None:
    for number in range(first, last):
        x = torch.randn(4, 16, 6, 6, generator=torch.Generator().manual_seed(number))
        optimizer.zero_grad()
        (net(x) - x[:, :2, 1:-1, 1:-1]).square().mean().backward()
        optimizer.step(0.02)


@pytest.fixture(params=[False, True], autouse=True)
def _with_and_without_bfloat16(request, monkeypatch) -> None:
    monkeypatch.setattr(optimizer, "uses_bfloat16", lambda device: request.param)


@pytest.mark.parametrize("memory_format", [torch.contiguous_format, torch.channels_last])
def test_every_parameter_moves_and_the_update_of_filters_is_orthogonal(memory_format):
    net = network(memory_format)
    before = {name: p.detach().clone() for name, p in net.named_parameters()}
    optimizer = HybridOptimizer(net, 0.02, weight_decay=0.0)
    train(net, optimizer, 0, 1)
    assert all(not torch.equal(p, before[name]) for name, p in net.named_parameters())
    update = (net[0].weight.detach() - before["0.weight"]).flatten(1)
    singular = torch.linalg.svdvals(update)
    # Newton-Schulz stops at roughly orthogonal: singular values within 0.6 to 1.3 of one scale.
    assert singular.min() > 0.4 * singular.max()


def test_both_memory_formats_give_the_same_updates():
    nets = [network(torch.contiguous_format), network(torch.channels_last)]
    for net in nets:
        train(net, HybridOptimizer(net, 0.02, weight_decay=0.0), 0, 3)
    for a, b in zip(*(net.parameters() for net in nets), strict=True):
        # Columns stand in another order, and Newton-Schulz runs in bfloat16.
        assert torch.allclose(a, b, atol=2e-3)


def test_frozen_parameters_stay_and_state_resumes():
    whole, halves, resumed = (network(torch.channels_last) for _ in range(3))
    for net in (whole, halves, resumed):
        net[3].bias.requires_grad_(False)
    train(whole, HybridOptimizer(whole, 0.02, 1e-4), 0, 6)
    first = HybridOptimizer(halves, 0.02, 1e-4)
    train(halves, first, 0, 3)
    second = HybridOptimizer(resumed, 0.02, 1e-4)
    resumed.load_state_dict(halves.state_dict())
    second.load_state(first.state())
    train(resumed, second, 3, 6)
    for a, b in zip(whole.parameters(), resumed.parameters(), strict=True):
        assert torch.equal(a, b)
    assert torch.equal(whole[3].bias, network(torch.channels_last)[3].bias)


@pytest.mark.parametrize("shape", [(24, 144), (144, 24), (16, 16)])
def test_float32_muon_equals_pytorchs(shape):
    torch.manual_seed(1)
    start = torch.randn(shape)
    ends = []
    for kind in (torch.optim.Muon, Float32Muon):
        generator = torch.Generator().manual_seed(2)
        matrix = nn.Parameter(start.clone())
        optimizer = kind([matrix], 0.02, weight_decay=0.0, adjust_lr_fn="match_rms_adamw")
        for _ in range(4):
            matrix.grad = torch.randn(shape, generator=generator)
            optimizer.step()
        ends.append(matrix.detach() - start)
    assert (ends[0] - ends[1]).norm() < 0.03 * ends[0].norm()  # bfloat16's rounding
