"""Figure 6: what lies between the images and the keypoints.

Of Early-Fusion the depth map; of Mid-Fusion the features and the distribution of the keypoints in
its volume, cut through the object's center.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.utils._pytree import tree_map_only

from ...core.geometry import View, transform
from ...core.image_crop import warp_crop
from ...core.plotting import INK, new_figure, save
from ..evaluation.metrics import nearest_symmetric_pose
from .images import Example
from .study import Estimator

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..networks.volume import LevelOutput, VolumeNet


def plot_activations(
    example: Example,
    estimators: Mapping[str, Estimator],
    depth: np.ndarray | None,
    path: Path,
) -> Path | None:
    """Figure 6 for the networks that there are.

    Args:
        example: the pair; its methods' answers select the symmetric equivalent of the truth.
        estimators: ``early`` and ``mid`` are looked into.
        depth: the reference's depth map as the sensor saw it, (H, W) m, to draw beside; or None.
        path: of the figure.

    Returns:
        The figure, or None if neither method is there.
    """
    rows = [method for method in ("early", "mid") if method in estimators]
    if not rows:
        return None
    figure = new_figure(13.2, 2.9 * len(rows) + 0.3)
    strips = figure.subfigures(len(rows), 1, squeeze=False)[:, 0]
    views = [example.reference, example.second]
    name = example.model.name
    for method, strip in zip(rows, strips, strict=True):
        row = strip.subplots(1, 5)
        estimator = estimators[method]
        networks: Any = estimator.networks  # type: ignore[attr-defined]
        if method == "early":
            with capture_forward(networks.cascade) as calls:
                estimator.estimate(views, name)
            (given, *_), outputs = calls[-1]
            around = example.T_cam_obj[2, 3] + 0.8 * example.model.diameter * np.array([-1, 1])
            draw_depth(row, example.reference, given.K[0, 0].numpy(), outputs[-1], depth, around)
        else:
            with (
                capture_forward(networks.volume.fine.trunk) as trunk,
                capture_forward(networks.volume) as top,
            ):
                answer = estimator.estimate(views, name)
            T_near = nearest_symmetric_pose(answer.T_cam_obj, example.T_cam_obj, example.model)
            truth = transform(T_near, example.model.keypoints)
            draw_volume(row, networks.volume, trunk[-1][0][0], top[-1][1][-1], truth)
        strip.suptitle(method, fontsize=12, fontweight="bold", color=INK, x=0.01, ha="left")
    figure.suptitle(example.title, fontsize=12, color=INK, x=0.01, ha="left")
    return save(figure, path)


def draw_depth(
    axes: Sequence[Axes],
    view: View,
    K_crop: np.ndarray,
    stage: Any,
    sensed: np.ndarray | None,
    around: np.ndarray,
) -> None:
    """Five panels: the crop, its depth, how sure it is, the sensor's depth, and the difference.

    Args:
        axes: five.
        view: the reference view.
        K_crop: (3, 3) camera of the crop.
        stage: the cascade's last :class:`~.cascade.DepthOutput`.
        sensed: depth map of the whole view, (H, W) m, 0 = unknown, or None.
        around: (2,) ends of the depths that the colors tell apart, m.
    """
    found = stage.depth[0].float().numpy()
    side = found.shape[0] * stage.stride
    affine = K_crop.astype(np.float64) @ np.linalg.inv(view.K)
    axes[0].imshow(warp_crop(view.image, affine, side))
    axes[0].set_title("reference view", fontsize=9.5)
    low, high = around
    deviation = 1e3 * stage.variance[0].float().sqrt().numpy()
    panels = [
        ("depth (m)", found, "viridis", low, high),
        ("its deviation (mm)", deviation, "magma", 0, float(deviation.max())),
    ]
    if sensed is not None:
        cut = cv2.warpAffine(sensed, affine[:2], (side, side), flags=cv2.INTER_NEAREST)
        cut = cut[stage.stride // 2 :: stage.stride, stage.stride // 2 :: stage.stride]
        known = np.where(cut > 0, cut, np.nan)
        panels += [
            ("depth sensor (m)", known, "viridis", low, high),
            ("difference (mm)", 1e3 * np.abs(found - known), "magma", 0, 50),
        ]
    for axis, (title, values, colors, minimum, maximum) in zip(axes[1:], panels, strict=False):
        image = axis.imshow(values, cmap=colors, vmin=minimum, vmax=maximum)
        bar = axis.figure.colorbar(image, ax=axis, fraction=0.05, pad=0.03)
        bar.ax.tick_params(labelsize=7)
        bar.outline.set_visible(False)  # type: ignore[operator]
        axis.set_title(title, fontsize=9.5)
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])
    for axis in axes[1 + len(panels) :]:
        axis.set_visible(False)


@contextmanager
def capture_forward(module: nn.Module) -> Iterator[list[tuple[tuple[Any, ...], Any]]]:
    """Records inputs and output of every call of a module while the context is open, on the CPU."""
    calls: list[tuple[tuple[Any, ...], Any]] = []

    def record(_: nn.Module, given: tuple[Any, ...], out: Any) -> None:
        calls.append(tree_map_only(Tensor, Tensor.cpu, (given, out)))

    hook = module.register_forward_hook(record)
    try:
        yield calls
    finally:
        hook.remove()


def draw_volume(
    axes: Sequence[Axes],
    volume: VolumeNet,
    trunk_input: Tensor,
    level: LevelOutput,
    truth: np.ndarray,
) -> None:
    """Five panels: both views' features, and the keypoints' distribution from three sides.

    Args:
        axes: five.
        volume: the networks' volume.
        trunk_input: (1, C, N, N, N) what its fine level's 3D network got.
        level: what that level answered.
        truth: (9, 3) the true keypoints in the reference camera, m.
    """
    count = trunk_input.shape[-1]
    cells = level.cells[0].reshape(count, count, count, 3).numpy()
    middle = count // 2
    edges = cells.reshape(-1, 3).min(0), cells.reshape(-1, 3).max(0)
    half = float(level.cell_size[0]) / 2
    channels = volume.fine.outside.numel()
    parts = trunk_input[0, : 2 * channels].float().unflatten(0, (2, channels))
    names = ("features, reference view", "features, second view")
    for axis, title, colors in zip(axes[:2], names, _colors(parts), strict=True):
        # From above: x to the right, z (depth) upwards.
        axis.imshow(
            colors[:, middle].transpose(1, 0, 2), origin="lower",
            extent=_extent(edges, (0, 2), half), interpolation="nearest",
        )  # fmt: skip
        _mark(axis, 100 * truth[:, [0, 2]], "o", mfc="none", mec="white", ms=6)
        _label(axis, title, "x (cm)", "depth (cm)")
    probability = level.log_probability[0].exp().reshape(-1, count, count, count).numpy()
    for axis, (a, b), title in zip(
        axes[2:], ((0, 1), (0, 2), (2, 1)), ("from the front", "from above", "from the side"),
        strict=True,
    ):  # fmt: skip
        gone = ({0, 1, 2} - {a, b}).pop()
        # Each keypoint's marginal, scaled to its peak: all nine can be seen.
        marginal = probability.sum(axis=gone + 1)
        marginal = (marginal / marginal.max(axis=(1, 2), keepdims=True)).max(axis=0)
        image = marginal.T if a < b else marginal
        axis.imshow(
            image, origin="lower", extent=_extent(edges, (a, b), half), cmap="magma",
            interpolation="nearest",
        )  # fmt: skip
        found = level.keypoints[0].numpy()
        _mark(axis, 100 * truth[:, [a, b]], "o", mfc="none", mec="#7ee787", ms=6)
        _mark(axis, 100 * found[:, [a, b]], "x", color="white", ms=4, mew=1)
        words = ("x (cm)", "y (cm)", "depth (cm)")
        _label(axis, f"keypoints {title}", words[a], words[b])
        if b == 1:
            axis.invert_yaxis()  # y points down in the camera


def _mark(axis: Axes, points: np.ndarray, mark: str, **style: Any) -> None:
    """Marks points (N, 2) on a slice, which keeps its borders."""
    axis.autoscale(False)
    axis.plot(points[:, 0], points[:, 1], mark, **style)


def _colors(parts: Tensor) -> np.ndarray:
    """Features (V, C, N, N, N) as colors (V, N, N, N, 3): their three main directions."""
    flat = parts.movedim(1, -1).reshape(-1, parts.shape[1])
    flat = flat - flat.mean(0)
    _, _, directions = torch.linalg.svd(flat, full_matrices=False)
    shown = flat @ directions[:3].T
    low, high = shown.quantile(0.02, dim=0), shown.quantile(0.98, dim=0)
    shown = ((shown - low) / (high - low).clamp_min(1e-6)).clamp(0, 1)
    return shown.reshape(*parts.shape[:1], *parts.shape[2:], 3).numpy()


def _extent(
    edges: tuple[np.ndarray, np.ndarray], axes: tuple[int, int], half: float
) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of a slice in centimeters."""
    low, high = edges
    a, b = axes
    bounds = (low[a] - half, high[a] + half, low[b] - half, high[b] + half)
    return tuple(float(100 * bound) for bound in bounds)  # type: ignore[return-value]


def _label(axis: Axes, title: str, x: str, y: str) -> None:
    axis.set_title(title, fontsize=9.5)
    axis.set_xlabel(x, fontsize=8)
    axis.set_ylabel(y, fontsize=8)
    axis.tick_params(labelsize=7, color="#8c959f", labelcolor=INK)
