"""The cascade: depth ranges, precision, and the cost volume at the true depth."""

import itertools

import cv2
import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F
from two_view_pose.core.geometry import grid_matrix, make_transform
from two_view_pose.pose_estimator.networks.cascade import (
    CascadeNet,
    CascadeViews,
    build_cost_volume,
)
from two_view_pose.pose_estimator.networks.encoder import PYRAMID_CHANNELS

GUESS, DIAMETER = 0.9137, 0.12


def views(batch: int = 1, count: int = 2, seed: int = 0, crop: int = 64) -> CascadeViews:
    """Random maps of crops of cameras around one point."""
    generator = torch.Generator().manual_seed(seed)
    maps = tuple(
        torch.rand(batch, count, channels, crop // stride, crop // stride, generator=generator)
        for channels, stride in zip(PYRAMID_CHANNELS, (2, 4, 8, 16), strict=False)
    )
    K = torch.tensor([[300.0, 0, 31.5], [0, 300, 31.5], [0, 0, 1]])
    T = torch.eye(4).repeat(batch, count, 1, 1)
    for view in range(1, count):
        angle = 0.3 * view
        T[:, view, 0, 0] = T[:, view, 2, 2] = np.cos(angle)
        T[:, view, 0, 2], T[:, view, 2, 0] = np.sin(angle), -np.sin(angle)
        spot = torch.tensor([0, 0, GUESS])
        T[:, view, :3, 3] = spot - T[:, view, :3, :3] @ spot
    return CascadeViews(maps, K.expand(batch, count, 3, 3), T)


def run(net: CascadeNet, given: CascadeViews, diameter: float = DIAMETER):
    batch = len(given.K)
    return net(given, torch.full((batch,), GUESS), torch.full((batch,), diameter))


@pytest.fixture(scope="module")
def net() -> CascadeNet:
    torch.manual_seed(0)
    return CascadeNet().eval()


@pytest.fixture(scope="module")
def uniform() -> CascadeNet:
    """A cascade with uniform distributions over the depths."""
    torch.manual_seed(0)
    net = CascadeNet().eval()
    for cost_net in net.costs:
        nn.init.zeros_(cost_net.output.weight)
    return net


def test_depth_ranges_narrow_to_the_papers_spacing(net: CascadeNet):
    with torch.no_grad():
        outputs = run(net, views(2))
    strides = [output.stride for output in outputs]
    assert sorted(strides, reverse=True) == strides and strides[-1] == 2
    assert [output.depth.shape[1:] for output in outputs] == [(64 // s, 64 // s) for s in strides]
    halves = [float(output.half_range[0]) for output in outputs]
    assert sorted(halves, reverse=True) == halves
    last = net.config.levels[-1]
    assert last.spacing == 0.0035
    assert halves[-1] == pytest.approx(0.0035 * (last.planes - 1) / 2)
    assert torch.allclose(outputs[0].center, torch.tensor(GUESS))
    for output, finer in itertools.pairwise(outputs):
        assert ((output.depth - output.center).abs() <= output.half_range[:, None, None]).all()
        size = finer.depth.shape[1:]
        enlarged = np.stack(
            [cv2.resize(d, size, interpolation=cv2.INTER_LINEAR) for d in output.depth.numpy()]
        )
        assert np.allclose(finer.center, enlarged, atol=1e-5)


@pytest.mark.parametrize(("diameter", "half"), [(0.1, 0.15), (0.28, 0.28)])
def test_first_range_contains_the_object(net: CascadeNet, diameter, half):
    with torch.no_grad():
        assert float(run(net, views(), diameter)[0].half_range[0]) == pytest.approx(half)


@pytest.mark.slow
def test_geometry_stays_float32_under_autocast(uniform: CascadeNet):
    # In bfloat16, 0.9137 would be 0.914 and 3.5 mm nothing.
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        outputs = run(uniform, views())
    for output, level in zip(outputs, uniform.config.levels, strict=True):
        assert output.depth.dtype == torch.float32
        assert torch.allclose(output.depth, torch.tensor(GUESS), atol=1e-6)
        steps = np.linspace(-1, 1, level.planes) * float(output.half_range[0])
        assert torch.allclose(output.variance, torch.tensor(steps.var()).float(), rtol=1e-3)


def test_third_view_and_view_without_overlap(net: CascadeNet):
    given = views(count=3)
    away = given.T_view_ref.clone()
    away[:, 2] = torch.from_numpy(make_transform(np.diag([1.0, -1, -1]), np.array([0, 0, 0.2])))
    with torch.no_grad():
        two, three, blind = (
            run(net, v)[-1].depth
            for v in (
                CascadeViews(
                    tuple(m[:, :2] for m in given.maps), given.K[:, :2], given.T_view_ref[:, :2]
                ),
                given,
                given._replace(T_view_ref=away),
            )
        )
    assert torch.isfinite(torch.stack([two, three, blind])).all()
    assert not torch.equal(two, three)


def test_every_parameter_has_a_gradient(net: CascadeNet):
    torch.manual_seed(1)
    trained = CascadeNet().train()
    sum(output.depth.square().sum() for output in run(trained, views(2))).backward()
    for name, parameter in trained.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0, name


def test_cost_volume_peaks_at_the_true_depth():
    # A textured slanted plane in both views: OpenCV warps the first into the second.
    rng = np.random.default_rng(0)
    stride, side = 2, 48
    K = np.array([[300.0, 0, 47.5], [0, 300, 47.5], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.05, 0.4, 0.1]))[0]
    T[:3, 3] = np.array([0, 0, 0.9]) - T[:3, :3] @ np.array([0, 0, 0.9])
    n, d = np.array([0.2, -0.1, 1.0]), 0.9  # n^T X = d
    to_grid = grid_matrix(stride)
    K_grid = to_grid @ K
    H = K_grid @ (T[:3, :3] + np.outer(T[:3, 3], n) / d) @ np.linalg.inv(K_grid)
    phase = cv2.GaussianBlur(rng.uniform(-30, 30, (side, side, 4)), (0, 0), 2.0)
    reference = np.concatenate([np.cos(phase), np.sin(phase)], 2).astype(np.float32)
    second = np.stack(
        [cv2.warpPerspective(c, H, (side, side)) for c in np.moveaxis(reference, 2, 0)]
    )
    maps = torch.from_numpy(np.stack([np.moveaxis(reference, 2, 0), second]))[None]
    rows, columns = np.indices((side, side))
    rays = np.stack([columns, rows, np.ones((side, side))], -1) @ np.linalg.inv(K_grid).T
    depth = d / (rays @ n)
    offsets = np.arange(-10, 11) * 0.008
    depths = torch.from_numpy(depth + offsets[:, None, None]).float()[None]
    cost = build_cost_volume(
        maps,
        torch.from_numpy(np.stack([K_grid, K_grid])).float()[None],
        torch.from_numpy(np.stack([np.eye(4), T])).float()[None],
        depths,
        groups=4,
    )
    assert cost.shape == (1, 5, 21, side, side)
    middle = cost[0, :, :, 12:-12, 12:-12]
    assert (middle[4] == 1).all()
    # Averages windows, since single pixels are ambiguous.
    best = F.avg_pool2d(middle[:4].mean(0), 5, 1).argmax(0)
    assert float(((best - 10).abs() <= 1).float().mean()) > 0.97
