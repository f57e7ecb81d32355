"""Figure 6: intermediate outputs of the networks.

For Early-Fusion the depth map; for Mid-Fusion a slice of the feature volume through the object's
center, and the distribution of the keypoints in it.
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
from ..evaluation.evaluate_pairs import Estimator
from ..evaluation.metrics import nearest_symmetric_pose
from .images import Example

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..networks.volume import LevelOutput, VolumeNet


def plot_activations(
    example: Example,
    estimators: Mapping[str, Estimator],
    depth: np.ndarray | None,
    path: Path,
) -> Path | None:
    """Draws Figure 6 for ``early`` and ``mid``; returns its path, or None if neither is there.

    ``depth`` is the reference's depth map from the sensor, (H, W) m, for comparison.
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
            (inputs, *_), outputs = calls[-1]
            limits = example.T_cam_obj[2, 3] + 0.8 * example.model.diameter * np.array([-1, 1])
            draw_depth(row, example.reference, inputs.K[0, 0].numpy(), outputs[-1], depth, limits)
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


@contextmanager
def capture_forward(module: nn.Module) -> Iterator[list[tuple[tuple[Any, ...], Any]]]:
    """Records inputs and output of every call of a module while the context is open, on the CPU."""
    calls: list[tuple[tuple[Any, ...], Any]] = []

    def record(_: nn.Module, inputs: tuple[Any, ...], output: Any) -> None:
        calls.append(tree_map_only(Tensor, Tensor.cpu, (inputs, output)))

    hook = module.register_forward_hook(record)
    try:
        yield calls
    finally:
        hook.remove()


def draw_depth(
    axes: Sequence[Axes],
    view: View,
    K_crop: np.ndarray,
    stage: Any,
    sensor: np.ndarray | None,
    limits: np.ndarray,
) -> None:
    """Draws the crop, its depth with the standard deviation, the sensor's depth, the difference.

    Args:
        view: the reference view.
        K_crop: (3, 3) camera of the crop.
        stage: the cascade's last ``DepthOutput``.
        sensor: depth map of the view, (H, W) m, 0 = unknown, or None.
        limits: (2,) range of the color scale, m.
    """
    found = stage.depth[0].float().numpy()
    side = found.shape[0] * stage.stride
    affine = K_crop.astype(np.float64) @ np.linalg.inv(view.K)
    axes[0].imshow(warp_crop(view.image, affine, side))
    axes[0].set_title("reference view", fontsize=9.5)
    deviation = 1e3 * stage.variance[0].float().sqrt().numpy()
    panels = [
        ("depth (m)", found, "viridis", *limits),
        ("its deviation (mm)", deviation, "magma", 0, float(deviation.max())),
    ]
    if sensor is not None:
        crop = cv2.warpAffine(sensor, affine[:2], (side, side), flags=cv2.INTER_NEAREST)
        crop = crop[stage.stride // 2 :: stage.stride, stage.stride // 2 :: stage.stride]
        known = np.where(crop > 0, crop, np.nan)
        panels += [
            ("depth sensor (m)", known, "viridis", *limits),
            ("difference (mm)", 1e3 * np.abs(found - known), "magma", 0, 50),
        ]
    for axis, (title, values, colors, low, high) in zip(axes[1:], panels, strict=False):
        image = axis.imshow(values, cmap=colors, vmin=low, vmax=high)
        bar = axis.figure.colorbar(image, ax=axis, fraction=0.05, pad=0.03)
        bar.ax.tick_params(labelsize=7)
        bar.outline.set_visible(False)  # type: ignore[operator]
        axis.set_title(title, fontsize=9.5)
    for axis in axes:
        axis.set(xticks=[], yticks=[])
    for axis in axes[1 + len(panels) :]:
        axis.set_visible(False)


def draw_volume(
    axes: Sequence[Axes],
    volume: VolumeNet,
    trunk_input: Tensor,
    level: LevelOutput,
    truth: np.ndarray,
) -> None:
    """Draws the features of both views, and the keypoints' distribution along three axes.

    Args:
        volume: the networks' volume.
        trunk_input: (1, C, N, N, N) input of the 3D network of its fine level.
        level: output of that level.
        truth: (9, 3) the true keypoints in the reference camera, m.
    """
    count = trunk_input.shape[-1]
    cells = level.cells[0].reshape(-1, 3).numpy()
    half = float(level.cell_size[0]) / 2
    low, high = 100 * (cells.min(0) - half), 100 * (cells.max(0) + half)
    names = ("x (cm)", "y (cm)", "depth (cm)")

    def show(axis: Axes, image: np.ndarray, a: int, b: int, color: str, title: str) -> None:
        extent = tuple(float(end) for end in (low[a], high[a], low[b], high[b]))
        axis.imshow(image, cmap="magma", origin="lower", extent=extent, interpolation="nearest")  # type: ignore[arg-type]
        axis.autoscale(False)
        axis.plot(*(100 * truth[:, [a, b]]).T, "o", mfc="none", mec=color, ms=6)
        axis.set_title(title, fontsize=9.5)
        axis.set_xlabel(names[a], fontsize=8)
        axis.set_ylabel(names[b], fontsize=8)
        axis.tick_params(labelsize=7, color="#8c959f", labelcolor=INK)

    channels = volume.fine.outside.numel()
    features = trunk_input[0, : 2 * channels].float().unflatten(0, (2, channels))
    for axis, colors, view in zip(axes, _colors(features), ("reference", "second"), strict=False):
        from_above = colors[:, count // 2].transpose(1, 0, 2)
        show(axis, from_above, 0, 2, "white", f"features, {view} view")
    probability = level.log_probability[0].exp().reshape(-1, count, count, count).numpy()
    keypoints = 100 * level.keypoints[0].numpy()
    sides = (("from the front", 0, 1), ("from above", 0, 2), ("from the side", 2, 1))
    for axis, (side, a, b) in zip(axes[2:], sides, strict=True):
        # Scales each keypoint's marginal to its peak, so that all nine can be seen.
        marginal = probability.sum(axis=1 + 3 - a - b)
        marginal = (marginal / marginal.max(axis=(1, 2), keepdims=True)).max(axis=0)
        image = marginal.T if a < b else marginal
        show(axis, image, a, b, "#7ee787", f"keypoints {side}")
        axis.plot(keypoints[:, a], keypoints[:, b], "x", color="white", ms=4, mew=1)
        if b == 1:
            axis.invert_yaxis()  # y points down in the camera


def _colors(features: Tensor) -> np.ndarray:
    """Maps features (V, C, N, N, N) to colors (V, N, N, N, 3) by their principal components."""
    flat = features.movedim(1, -1).reshape(-1, features.shape[1])
    flat = flat - flat.mean(0)
    _, _, directions = torch.linalg.svd(flat, full_matrices=False)
    components = flat @ directions[:3].T
    low, high = components.quantile(0.02, dim=0), components.quantile(0.98, dim=0)
    colors = ((components - low) / (high - low).clamp_min(1e-6)).clamp(0, 1)
    return colors.reshape(*features.shape[:1], *features.shape[2:], 3).numpy()
