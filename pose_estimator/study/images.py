"""Figure 5: the estimate of each method for a pair of views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.geometry import View, crop_matrix, invert, project, transform
from ...core.image_crop import warp_crop
from ...core.plotting import INK, new_figure, save
from ..evaluation.metrics import nearest_symmetric_pose
from ..methods import METHOD_TABLE
from ..types import PoseEstimate
from ..visualization import ESTIMATE_COLOR, TRUE_COLOR, draw_poses

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CROP = 320
"""Side of a crop, pixels."""

_CROP_DIAMETERS = 1.5
"""Side of a crop, diameters of the object."""

_PLOT_FROM_CAMERA = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""OpenCV's axes (right, down, forward) as the plot's (right, forward, up), for row vectors."""

_LEGEND = """above: keypoints in the
reference view; ring: true,
dot: predicted

middle: the same in space,
seen from the right, depth
to the right; what leaves
the box is left out

below: pose; green: true,
orange: estimated"""


@dataclass(frozen=True, eq=False)
class Example:
    """A pair of views with the target, its true T_cam_obj (4, 4) and each method's answer."""

    title: str
    model: ObjectModel
    reference: View
    second: View
    T_cam_obj: np.ndarray
    answers: Mapping[str, PoseEstimate]

    def crop(self, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cuts out the object: returns image, its K (3, 3), and T_cam_obj (4, 4) in the view."""
        T = view.T_cam_world @ invert(self.reference.T_cam_world) @ self.T_cam_obj
        side = _CROP_DIAMETERS * self.model.diameter * view.K[0, 0] / T[2, 3]
        affine = crop_matrix(project(T[:3, 3], view.K), side, CROP)
        return warp_crop(view.image, affine, CROP), affine @ view.K, T


def draw_example(example: Example, path: Path) -> Path:
    """Draws the views, and a column for each method: keypoints in the image, in 3D, the pose."""
    columns = len(example.answers) + 1
    figure = new_figure(2.35 * columns, 7.3)
    axes = figure.subplots(3, columns, squeeze=False)
    for row, view, title in ((0, example.reference, "reference"), (2, example.second, "second")):
        crop, K, T = example.crop(view)
        _show(axes[row, 0], draw_poses(crop, example.model, {TRUE_COLOR: T}, K))
        axes[row, 0].set_title(f"{title} view", fontsize=11)
    axes[1, 0].set_axis_off()
    axes[1, 0].text(0.0, 0.5, _LEGEND, fontsize=9, color=INK, va="center", linespacing=1.35)
    crop, K, T_true = example.crop(example.reference)
    for column, (method, answer) in enumerate(example.answers.items(), start=1):
        color = METHOD_TABLE[method].color
        T_near = nearest_symmetric_pose(answer.T_cam_obj, T_true, example.model)
        truth = transform(T_near, example.model.keypoints)
        error = np.linalg.norm(answer.keypoints - truth, axis=1).mean()
        title = f"{method}: {1000 * error:.1f} mm"
        axes[0, column].set_title(title, fontsize=11, color=color, fontweight="bold")
        _keypoints_in_image(axes[0, column], crop, K, truth, answer.keypoints, color)
        place = axes[1, column].get_subplotspec()
        axes[1, column].remove()
        solid = figure.add_subplot(place, projection="3d")
        _keypoints_in_space(solid, truth, answer.keypoints, example.model, color)
        poses = {TRUE_COLOR: T_true, ESTIMATE_COLOR: answer.T_cam_obj}
        _show(axes[2, column], draw_poses(crop, example.model, poses, K))
    figure.suptitle(example.title, fontsize=12, color=INK, x=0.01, ha="left")
    return save(figure, path)


def _keypoints_in_image(
    axis: Axes, crop: np.ndarray, K: np.ndarray, truth: np.ndarray, found: np.ndarray, color: str
) -> None:
    _show(axis, crop)
    true_pixels = project(truth, K)
    in_front = found[:, 2] > 0.01
    pixels = project(np.where(in_front[:, None], found, truth), K)
    for a, b in zip(true_pixels, pixels, strict=True):
        axis.plot(*zip(a, b, strict=True), color="white", linewidth=2.2)
        axis.plot(*zip(a, b, strict=True), color=color, linewidth=1.2)
    ring = {"facecolors": "none", "edgecolors": "white", "linewidths": 1.4}
    axis.scatter(true_pixels[:, 0], true_pixels[:, 1], s=34, **ring)  # type: ignore[arg-type]
    axis.scatter(pixels[:, 0], pixels[:, 1], s=13, color=color, edgecolors="white", linewidths=0.5)
    axis.set(xlim=(0, CROP), ylim=(CROP, 0))


def _keypoints_in_space(
    axis: Any, truth: np.ndarray, found: np.ndarray, model: ObjectModel, color: str
) -> None:
    """Draws truth and prediction around the object's center, seen from the camera's right."""
    center, reach = truth.mean(0), 0.75 * model.diameter
    true, predicted = (100 * ((points - center) @ _PLOT_FROM_CAMERA) for points in (truth, found))
    for a, b in zip(true, predicted, strict=True):
        axis.plot(*zip(a, b, strict=True), color=color, linewidth=1.0, axlim_clip=True)
    shared = {"depthshade": False, "axlim_clip": True}
    axis.scatter(*true.T, s=22, facecolors="none", edgecolors=INK, linewidths=1.0, **shared)
    axis.scatter(*predicted.T, s=14, color=color, **shared)
    ticks = [-100 * reach / 2, 0, 100 * reach / 2]
    for name, title in (("x", "x"), ("y", "depth"), ("z", "up")):
        getattr(axis, f"set_{name}lim")(-100 * reach, 100 * reach)
        getattr(axis, f"set_{name}ticks")(ticks, [f"{tick:.0f}" for tick in ticks])
        getattr(axis, f"set_{name}label")(f"{title} (cm)", fontsize=8, labelpad=-8)
    axis.view_init(elev=18, azim=-28)
    axis.set_box_aspect((1, 1, 1), zoom=0.9)
    axis.tick_params(labelsize=7, pad=-3)


def _show(axis: Axes, image: np.ndarray) -> None:
    axis.imshow(image)
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)
