"""The study's charts and example images."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import LINEMOD_K, View, make_transform, project, transform
from two_view_pose.core.plotting import new_figure
from two_view_pose.pose_estimator.bop.dataset import read_dataset, read_pairs, read_rgb
from two_view_pose.pose_estimator.fusion.mid import MidFusionEstimator
from two_view_pose.pose_estimator.networks.volume import LevelOutput, voxel_centers
from two_view_pose.pose_estimator.study.figures import draw_charts
from two_view_pose.pose_estimator.study.images import (
    CROP,
    Example,
    draw_gaps,
    draw_poses_of_methods,
)
from two_view_pose.pose_estimator.study.insides import capture_forward, draw_slices, plot_insides
from two_view_pose.pose_estimator.study.plan import NOISE
from two_view_pose.pose_estimator.types import PoseEstimate


@pytest.fixture(scope="module")
def example(dataset: Path, boxes) -> Example:
    """The brick in two images of the flat dataset."""
    pair = read_pairs(dataset)[0]
    scene = read_dataset(dataset, "train_pbr").scene(pair.scene_id)
    reference, second = scene[pair.ref_image_id], scene[pair.second_image_id]
    T = reference.annotation(boxes["brick"].obj_id).T_cam_obj
    shifted = T @ make_transform(np.eye(3), np.array([0.0, 0.0, 0.02]))
    answers = {
        method: PoseEstimate(pose, transform(pose, boxes["brick"].keypoints), np.zeros((9, 3, 3)))
        for method, pose in (("late", shifted), ("mid", T))
    }
    return Example(
        title="brick",
        model=boxes["brick"],
        reference=View(read_rgb(reference), reference.K, np.eye(4)),
        second=View(read_rgb(second), second.K, pair.T_second_ref),
        T_cam_obj=T,
        answers=answers,
    )


def test_crops_are_centered_on_the_object_in_both_views(example):
    for view in (example.reference, example.second):
        crop, K, T = example.crop(view)
        assert crop.shape == (CROP, CROP, 3)
        pixels = project(transform(T, example.model.keypoints), K)
        np.testing.assert_allclose(pixels[-1], (CROP - 1) / 2, atol=1e-6)
        assert (pixels > 0).all() and (pixels < CROP).all()
        # The color of the brick is at the center of the crop.
        assert crop[CROP // 2, CROP // 2, 0] > 150


@pytest.mark.slow
def test_the_poses_of_every_method_are_drawn(example, tmp_path):
    path = draw_poses_of_methods([example, example], tmp_path / "figures" / "poses_1.png")
    image = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert image.shape[1] > 2 * 150 and image.shape[0] > 4 * 150
    orange = (abs(image - (255, 122, 26)).sum(2) < 30).sum()
    green = (abs(image - (57, 190, 88)).sum(2) < 30).sum()
    assert orange > 50 and green > 100


def test_second_views_by_gap_are_drawn(example, tmp_path):
    path = draw_gaps(example.reference, {1: example.second, 5: example.second}, tmp_path / "g.png")
    assert Image.open(path).width > 600


@pytest.mark.slow
def test_the_insides_of_the_fusions_are_drawn(example, networks, tmp_path):
    estimator = MidFusionEstimator(networks)
    with capture_forward(networks.volume) as calls:
        path = plot_insides(example, {"mid": estimator}, tmp_path / "fusions_1.png")
    assert path is not None and Image.open(path).width > 1000
    assert calls
    alone = Example(**{**vars(example), "answers": {}})
    assert plot_insides(alone, {}, tmp_path / "b.png") is None


def test_keypoints_behind_the_camera_are_drawn(example, tmp_path):
    answer = example.answers["mid"]
    behind = PoseEstimate(answer.T_cam_obj, answer.keypoints - 5.0, answer.keypoint_covariance)
    odd = Example(**{**vars(example), "answers": {"mid": behind}})
    assert plot_insides(odd, {}, tmp_path / "a.png").is_file()


def test_slices_show_the_keypoints_where_they_are():
    cells = voxel_centers(torch.tensor([[0.0, 0.0, 1.0]]), torch.tensor([0.08]), 16)
    logits = torch.full((1, 9, 16**3), -20.0)
    numbers = torch.arange(9) * 400 + 37
    logits[0, torch.arange(9), numbers] = 0.0
    level = LevelOutput(logits, cells, torch.tensor([0.01]), cells[:, numbers], torch.zeros(1))
    figure = new_figure(8, 2)
    axes = figure.subplots(1, 4)
    truth = cells[0, numbers].numpy()
    draw_slices(axes, level, truth)
    rings = [line.get_xydata() for axis in axes for line in axis.lines]
    assert sum(len(points) for points in rings) == 9
    for axis, points in zip(axes, rings, strict=True):
        [image] = axis.images
        left, right, bottom, top = image.get_extent()
        for x, y in points:
            column = int((x - left) / (right - left) * 16)
            row = int((y - top) / (bottom - top) * 16)
            assert 0 <= column < 16 and 0 <= row < 16


def test_inputs_and_outputs_of_a_module_are_captured():
    layer = torch.nn.Linear(2, 1)
    with capture_forward(layer) as calls:
        out = layer(torch.ones(1, 2))
    layer(torch.zeros(1, 2))
    assert len(calls) == 1
    ((inputs,), output) = calls[0]
    assert inputs.tolist() == [[1.0, 1.0]] and output is out


def records() -> list[dict]:
    tags = {"unit": "", "method": "mid", "gap": 10, "scene": "linemod"}
    recall = [
        {"metric": "keypoint_recall", "value": 0.5, "low": 0.4, "high": 0.6, "object": name,
         "baseline": baseline, **tags}
        for name in ("cat", "mean") for baseline in (0.0125, 0.0375)
    ]  # fmt: skip
    noise = [
        {"metric": f"noise_{metric}", "value": 0.01, "training": "", "rotation_deg": r,
         "translation": t, **tags}
        for metric in ("add_s_recall", "keypoint_distance") for r, t in NOISE
    ]  # fmt: skip
    return recall + noise


@pytest.mark.slow
def test_charts_are_drawn_from_records_alone(tmp_path):
    made = draw_charts(records(), tmp_path / "a")
    assert set(made) == {"recall_linemod", "noise"}
    again = draw_charts(records(), tmp_path / "b")
    for name, path in made.items():
        assert path.read_text().startswith("<?xml") and path.suffix == ".svg"
        assert path.read_bytes() == again[name].read_bytes()
    assert draw_charts([], tmp_path) == {}


def test_rotations_of_the_camera_do_not_move_the_crop(boxes):
    """The second view's crop follows its own camera, also one that is rolled."""
    T = make_transform(np.eye(3), np.array([0.05, -0.02, 0.9]))
    roll = make_transform(Rotation.from_euler("z", 40, degrees=True).as_matrix(), np.zeros(3))
    image = np.zeros((480, 640, 3), np.uint8)
    views = View(image, LINEMOD_K, np.eye(4)), View(image, LINEMOD_K, roll)
    example = Example("x", boxes["brick"], *views, T, {})
    _, K, T_second = example.crop(views[1])
    np.testing.assert_allclose(project(T_second[:3, 3], K), (CROP - 1) / 2, atol=1e-6)
    np.testing.assert_allclose(T_second, roll @ T)
