"""Figure 5: what each fusion predicts for a pair of views, and what it computes on the way."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from torch import Tensor, nn
from torch.utils._pytree import tree_map_only

from ...core.geometry import project, transform
from ...core.plotting import INK, new_figure, save
from ..evaluation.evaluate_pairs import Estimator
from ..evaluation.metrics import nearest_symmetric_pose
from ..methods import METHOD_TABLE
from ..networks.volume import LevelOutput
from .images import CROP, Example, show

FUSIONS = ("early", "late", "mid")
"""The paper's methods, in the order of its figure."""

TRUE_POINTS = "#39be58"

SLICES = 4


def plot_insides(example: Example, estimators: Mapping[str, Estimator], path: Path) -> Path | None:
    """Draws Figure 5; returns its path, or None if none of the fusions is there.

    Above: both views with the true keypoints, then the keypoints of ``early``, its depth map, and
    those of ``late`` and ``mid``. Below: four slices of ``mid``'s keypoint distributions from near
    to far, and all keypoints in space, from the right and from above.
    """
    methods = [method for method in FUSIONS if method in example.answers]
    if not methods:
        return None
    figure = new_figure(15.5, 5.9)
    axes = figure.subplots(2, 6)
    for axis, view, title in zip(
        axes[0], (example.reference, example.second), ("reference view", "second view"),
        strict=False,
    ):  # fmt: skip
        crop, K, T = example.crop(view)
        points = project(transform(T, example.model.keypoints), K)
        _points_in_image(axis, crop, points, TRUE_POINTS, title)
    crop, K, T_true = example.crop(example.reference)
    for column, method in zip((2, 4, 5), FUSIONS, strict=True):
        axis = axes[0, column]
        if method not in methods:
            axis.set_axis_off()
            continue
        found, truth = example.answers[method].keypoints, _nearest_truth(example, method)
        error = 1000 * np.linalg.norm(found - truth, axis=1).mean()
        found = np.where(found[:, 2:] > 0.01, found, truth)
        color = METHOD_TABLE[method].color
        _points_in_image(axis, crop, project(found, K), color, f"{method}: {error:.1f} mm")
    views, name = [example.reference, example.second], example.model.name
    if "early" in estimators:
        networks: Any = estimators["early"].networks  # type: ignore[attr-defined]
        with capture_forward(networks.cascade) as calls:
            estimators["early"].estimate(views, name)
        limits = T_true[2, 3] + 0.8 * example.model.diameter * np.array([-1, 1])
        _draw_depth(axes[0, 3], calls[-1][1][-1], limits)
    else:
        axes[0, 3].set_axis_off()
    if "mid" in estimators:
        networks = estimators["mid"].networks  # type: ignore[attr-defined]
        with capture_forward(networks.volume) as calls:
            estimators["mid"].estimate(views, name)
        draw_slices(axes[1, :SLICES], calls[-1][1][-1], _nearest_truth(example, "mid"))
    else:
        for axis in axes[1, :SLICES]:
            axis.set_axis_off()
    _points_in_space(axes[1, SLICES], example, methods, 2, 1, "from the right")
    _points_in_space(axes[1, SLICES + 1], example, methods, 0, 2, "from above")
    figure.suptitle(example.title.replace("\n", ", "), fontsize=12, color=INK, x=0.01, ha="left")
    return save(figure, path)


def _nearest_truth(example: Example, method: str) -> np.ndarray:
    """The true keypoints (9, 3) in the equivalent pose that the method means."""
    T = nearest_symmetric_pose(example.answers[method].T_cam_obj, example.T_cam_obj, example.model)
    return transform(T, example.model.keypoints)


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


def _draw_depth(axis: Axes, stage: Any, limits: np.ndarray) -> None:
    """Draws the cascade's last depth map; ``limits`` (2,) is the range of colors, m."""
    image = axis.imshow(stage.depth[0].float().numpy(), vmin=limits[0], vmax=limits[1])
    bar = axis.figure.colorbar(image, ax=axis, fraction=0.05, pad=0.03)
    bar.ax.tick_params(labelsize=7)
    bar.outline.set_visible(False)  # type: ignore[operator]
    axis.set_title("early: depth (m)", fontsize=10)
    axis.set(xticks=[], yticks=[])


def draw_slices(axes: Sequence[Axes], level: LevelOutput, truth: np.ndarray) -> None:
    """Draws slices of the nine distributions of a volume, from near to far.

    Each distribution is scaled to its peak, so that all can be seen. A ring is a true keypoint
    (9, 3), in the slice that is nearest to it.
    """
    count = round(level.log_probability.shape[-1] ** (1 / 3))
    cells = level.cells[0].reshape(count, count, count, 3).numpy()
    probability = level.log_probability[0].exp().reshape(-1, count, count, count)
    scaled = (probability / probability.flatten(1).amax(1)[:, None, None, None]).amax(0).numpy()
    half = float(level.cell_size[0]) / 2
    low, high = cells[0, 0, 0] - half, cells[-1, -1, -1] + half
    numbers = np.linspace(0.2 * count, 0.8 * count - 1, len(axes)).round().astype(int)
    depths = cells[0, 0, numbers, 2]
    nearest = np.abs(truth[:, 2:] - depths).argmin(1)
    extent = tuple(100 * float(end) for end in (low[0], high[0], high[1], low[1]))
    for slot, (axis, number) in enumerate(zip(axes, numbers, strict=True)):
        axis.imshow(scaled[:, :, number].T, cmap="magma", vmin=0, vmax=1, extent=extent)  # type: ignore[arg-type]
        own = 100 * truth[nearest == slot]
        axis.plot(own[:, 0], own[:, 1], "o", mfc="none", mec=TRUE_POINTS, ms=7)
        axis.set_title(f"mid: slice at {100 * depths[slot]:.1f} cm", fontsize=10)
        axis.set_xlabel("x (cm)", fontsize=8)
        axis.tick_params(labelsize=7, color="#8c959f", labelcolor=INK)
    axes[0].set_ylabel("y (cm)", fontsize=8)


def _points_in_image(
    axis: Axes, crop: np.ndarray, pixels: np.ndarray, color: str, title: str
) -> None:
    show(axis, crop)
    axis.scatter(pixels[:, 0], pixels[:, 1], s=26, color=color, edgecolors="white", linewidths=0.8)
    axis.set(xlim=(0, CROP), ylim=(CROP, 0))
    axis.set_title(title, fontsize=10, color=INK if color == TRUE_POINTS else color)


def _points_in_space(
    axis: Axes, example: Example, methods: Sequence[str], a: int, b: int, title: str
) -> None:
    """Draws the true keypoints and those of the methods over two of the camera's axes."""
    truth = transform(example.T_cam_obj, example.model.keypoints)
    center, reach = truth.mean(0), 80 * example.model.diameter
    names = ("x (cm)", "y (cm)", "depth (cm)")
    for method in methods:
        color = METHOD_TABLE[method].color
        found = 100 * (example.answers[method].keypoints - center)
        meant = 100 * (_nearest_truth(example, method) - center)
        for one, other in zip(meant, found, strict=True):
            axis.plot([one[a], other[a]], [one[b], other[b]], color=color, linewidth=0.9)
        axis.plot(found[:, a], found[:, b], "o", color=color, ms=4, label=method)
    shown = 100 * (truth - center)
    axis.plot(shown[:, a], shown[:, b], "o", mfc="none", mec=TRUE_POINTS, ms=7, label="true")
    axis.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    if b == 1:
        axis.invert_yaxis()  # y points down in the camera
        axis.legend(fontsize=7, frameon=False, loc="upper left")
    axis.set_title(title, fontsize=10)
    axis.set_xlabel(names[a], fontsize=8)
    axis.set_ylabel(names[b], fontsize=8, labelpad=0)
    axis.tick_params(labelsize=7, color="#8c959f", labelcolor=INK)
