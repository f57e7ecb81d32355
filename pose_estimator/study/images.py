"""Figures 3 and 6: second views by gap, and the poses of every method."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ...assets.object_model import ObjectModel
from ...core.geometry import View, crop_matrix, invert, project
from ...core.image_crop import warp_crop
from ...core.plotting import INK, new_figure, save
from ..evaluation.metrics import CORRECT, add_or_add_s
from ..methods import METHOD_TABLE
from ..types import PoseEstimate
from ..visualization import ESTIMATE_COLOR, TRUE_COLOR, draw_poses

CROP = 320
"""Side of a crop, pixels."""

_CROP_DIAMETERS = 1.5
"""Side of a crop, diameters of the object."""


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


def draw_gaps(reference: View, seconds: Mapping[int, View], path: Path) -> Path:
    """Draws Figure 3: a reference view and the second views so many frames after it."""
    figure = new_figure(3.3 * (1 + len(seconds)), 2.9)
    axes = figure.subplots(1, 1 + len(seconds), squeeze=False)[0]
    show(axes[0], reference.image)
    axes[0].set_title("reference", fontsize=11)
    for axis, (gap, view) in zip(axes[1:], seconds.items(), strict=True):
        T_second_ref = view.T_cam_world @ invert(reference.T_cam_world)
        centimeters = 100 * float(np.linalg.norm(T_second_ref[:3, 3]))
        show(axis, view.image)
        axis.set_title(f"gap {gap}: the camera moved {centimeters:.1f} cm", fontsize=11)
    return save(figure, path)


def draw_poses_of_methods(examples: Sequence[Example], path: Path) -> Path:
    """Draws Figure 6: a row for each method, a column for each example, with outlines of poses."""
    methods = [m for m in METHOD_TABLE if any(m in example.answers for example in examples)]
    figure = new_figure(1.5 * len(examples) + 0.4, 1.62 * (2 + len(methods)) + 0.3)
    axes = figure.subplots(2 + len(methods), len(examples), squeeze=False)
    for column, example in zip(axes.T, examples, strict=True):
        views = (example.reference, example.second)
        for axis, view in zip(column, views, strict=False):
            crop, K, T = example.crop(view)
            show(axis, draw_poses(crop, example.model, {TRUE_COLOR: T}, K))
        column[0].set_title(example.title, fontsize=8.5, color=INK)
        crop, K, T_true = example.crop(example.reference)
        for axis, method in zip(column[2:], methods, strict=True):
            answer = example.answers.get(method)
            if answer is None:
                axis.set_axis_off()
                continue
            poses = {TRUE_COLOR: T_true, ESTIMATE_COLOR: answer.T_cam_obj}
            show(axis, draw_poses(crop, example.model, poses, K))
            error = add_or_add_s(answer.T_cam_obj, T_true, example.model) / example.model.diameter
            right = error < CORRECT
            text = f"{100 * error:.1f} % of d" if error < 9.995 else "> 10 d"
            axis.set_xlabel(text, fontsize=8.5, color="#1a7f37" if right else "#c8401e", labelpad=2)
    for axis, title in zip(axes[:, 0], ["reference view", "second view", *methods], strict=True):
        axis.set_ylabel(title, fontsize=10, color=INK)
    return save(figure, path)


def show(axis: Axes, image: np.ndarray) -> None:
    """Shows an image without ticks."""
    axis.imshow(image)
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)
