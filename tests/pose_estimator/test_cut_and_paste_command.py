"""The verb: poses of pasted objects agree with their pixels, and labels with what is seen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.bop import read_dataset, read_mask, read_rgb
from two_view_pose.pose_estimator.bop_models import write_models
from two_view_pose.pose_estimator.bop_models_info import read_models_info
from two_view_pose.pose_estimator.bop_writer import write_scene
from two_view_pose.pose_estimator.cut_and_paste_command import (
    CutAndPasteCommand,
    cover,
    cut_and_paste,
)
from two_view_pose.pose_estimator.geometry import LINEMOD_K, make_transform, project
from two_view_pose.pose_estimator.pasted_picture import turn_to

from .conftest import COLOURS, flat_frame, orbit, silhouette


@pytest.fixture(scope="module")
def backgrounds(tmp_path_factory) -> Path:
    """A folder with one green picture in a folder of its own."""
    folder = tmp_path_factory.mktemp("backgrounds")
    (folder / "some").mkdir()
    cv2.imwrite(str(folder / "some" / "green.png"), np.full((300, 500, 3), (30, 200, 30), np.uint8))
    return folder


@pytest.fixture(scope="module")
def made(dataset: Path, backgrounds: Path, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("pasted") / "out"
    cut_and_paste(
        CutAndPasteCommand(dataset, out, images=8, backgrounds=backgrounds, objects=(2, 2))
    )
    return out


def test_pixels_are_where_the_poses_say(made, boxes):
    models = {model.obj_id: model for model in boxes.values()}
    places = []
    for image in read_dataset(made, "train_pbr"):
        rgb = read_rgb(image).astype(int)
        assert image.T_cam_world is None and image.depth_path is None
        assert len(image.annotations) == 2
        # Cut out where they were whole: what is not seen now, the nearer one hides or the border.
        distance = [np.linalg.norm(a.T_cam_obj[:3, 3]) for a in image.annotations]
        assert distance[0] >= distance[1]
        nearer = silhouette(models[image.annotations[1].obj_id], image.annotations[1].T_cam_obj,
                            image.K)  # fmt: skip
        for annotation, hiding in zip(image.annotations, (nearer, None), strict=True):
            model = models[annotation.obj_id]
            expected = silhouette(model, annotation.T_cam_obj, image.K)
            if hiding is not None:
                expected &= ~hiding
            mask = read_mask(annotation)
            # The source is a polygon of whole pixels: its edge is good to a pixel.
            wrong = (mask != expected).sum()
            assert wrong < 1.5 * cv2.arcLength(_hull(model, annotation.T_cam_obj, image.K), True)
            inside = cv2.erode(mask.astype(np.uint8), np.ones((5, 5))) > 0
            assert (np.abs(rgb - COLOURS[model.name]).max(-1) < 40)[inside].mean() > 0.99
            assert annotation.px_count_visib == mask.sum()
            whole = cv2.contourArea(_hull(model, annotation.T_cam_obj, image.K))
            assert annotation.visibility == pytest.approx(mask.sum() / whole, abs=0.05)
            assert annotation.px_count_all == pytest.approx(whole, rel=0.05)
            low = _hull(model, annotation.T_cam_obj, image.K).min(0).ravel()
            assert np.abs(np.array(annotation.bbox_obj[:2]) - low).max() < 2.5
            places.append(project(annotation.T_cam_obj[:3, 3], image.K))
        background = ~np.any([read_mask(a) for a in image.annotations], axis=0)
        green = cv2.erode(background.astype(np.uint8), np.ones((5, 5))) > 0
        assert (np.abs(rgb - (30, 200, 30)).max(-1) < 40)[green].mean() > 0.99
    assert (np.std(places, axis=0) > 60).all()  # they land everywhere


def _hull(model, T_cam_obj, K) -> np.ndarray:
    pixels = project(model.vertices @ T_cam_obj[:3, :3].T + T_cam_obj[:3, 3], K)
    return cv2.convexHull(pixels.astype(np.float32))


def test_a_turn_about_the_centre_moves_pixels_alike_at_every_depth():
    K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
    rng = np.random.default_rng(0)
    for _ in range(5):
        direction = rng.normal(size=3) * (0.2, 0.2, 0) + (0, 0, 1)
        pixel = rng.uniform((50, 50), (590, 430))
        turn = turn_to(direction, pixel, K, roll=0.3)
        assert np.allclose(turn @ turn.T, np.eye(3)) and np.linalg.det(turn) > 0
        assert np.allclose(project(turn @ direction, K), pixel)
        homography = K @ turn @ np.linalg.inv(K)
        points = rng.normal(size=(20, 3)) * (0.2, 0.2, 0.5) + (0, 0, 1.5)
        before = cv2.perspectiveTransform(project(points, K)[None], homography)[0]
        assert np.allclose(before, project(points @ turn.T, K))
    # Without a roll it is the shortest turn.
    shortest = turn_to(np.array([0.1, 0, 1.0]), np.array([400.0, 240]), K)
    angle = np.arctan2(80, 500) - np.arctan2(0.1, 1)
    assert Rotation.from_matrix(shortest).magnitude() == pytest.approx(abs(angle))
    still = turn_to(np.array([0.0, 0, 2.0]), np.array([320.0, 240]), K)
    assert np.allclose(still, np.eye(3))


def test_objects_keep_their_place_without_move(dataset, boxes, backgrounds, tmp_path):
    command = CutAndPasteCommand(
        dataset, tmp_path, images=3, backgrounds=backgrounds, objects=(1, 1), move=False
    )
    cut_and_paste(command)
    sources = [a for image in read_dataset(dataset, "train_pbr") for a in image.annotations]
    for image in read_dataset(tmp_path, "train_pbr"):
        (annotation,) = image.annotations
        (same,) = [s for s in sources if np.allclose(s.T_cam_obj, annotation.T_cam_obj, atol=1e-6)]
        assert np.array_equal(read_mask(annotation), read_mask(same))
        assert annotation.bbox_obj == same.bbox_obj and annotation.visibility == 1


def test_a_frame_keeps_its_own_objects_behind_what_is_pasted(boxes, tmp_path):
    data, out = tmp_path / "data", tmp_path / "out"
    T_world_obj = make_transform(
        Rotation.from_euler("z", 30, degrees=True).as_matrix(), np.zeros(3)
    )
    for number, name in enumerate(("brick", "crate")):
        frame = flat_frame(boxes, {name: T_world_obj}, orbit(20 * number, 60, 0.9 - 0.2 * number))
        write_scene(data, "train_pbr", number, [frame], jpeg_quality=None)
    write_models(data, boxes.values())
    cut_and_paste(CutAndPasteCommand(data, out, images=6, move=False))
    own_visibility = set()
    for image in read_dataset(out, "train_pbr"):
        own, pasted = image.annotations
        assert {own.obj_id, pasted.obj_id} == {3, 7}
        mask, over = read_mask(own), read_mask(pasted)
        assert not (mask & over).any() and pasted.visibility == pytest.approx(1, abs=0.02)
        models = {model.obj_id: model for model in boxes.values()}
        whole = silhouette(models[own.obj_id], own.T_cam_obj, LINEMOD_K)
        assert np.array_equal(mask, whole & ~over)
        assert own.visibility == pytest.approx(mask.sum() / whole.sum())
        own_visibility.add(round(own.visibility, 2))
        colour = COLOURS[models[pasted.obj_id].name]
        assert np.abs(read_rgb(image)[over].mean(0) - colour).max() < 20
    assert min(own_visibility) < 0.9
    assert read_models_info(out).keys() == {3, 7}


def test_the_same_seed_and_a_restart_give_the_same_pictures(made, dataset, backgrounds, tmp_path):
    again = tmp_path / "again"
    command = CutAndPasteCommand(dataset, again, images=3, backgrounds=backgrounds, objects=(2, 2))
    cut_and_paste(command)
    cut_and_paste(replace(command, images=8))
    for number in range(8):
        name = f"train_pbr/{number:06d}/rgb/000000.jpg"
        assert (made / name).read_bytes() == (again / name).read_bytes()
    with pytest.raises(ValueError, match="holds a dataset with other settings"):
        cut_and_paste(replace(command, seed=1))


def test_backgrounds_cover_the_picture_undistorted():
    stripes = np.zeros((200, 900, 3), np.uint8)
    stripes[:, ::20] = 255
    for seed in range(4):
        piece = cover(stripes, (120, 160), np.random.default_rng(seed))
        assert piece.shape == (120, 160, 3)
        # 120 rows come from 120 to 200 rows; stripes lie as much nearer or farther.
        bright = np.flatnonzero(np.diff((piece[60, :, 0] > 40).astype(int)) > 0)
        assert 20 * 120 / 200 - 1.5 < np.diff(bright).mean() < 20 * 120 / 120 + 1.5


def test_what_is_wrong_is_told(dataset, tmp_path):
    with pytest.raises(ValueError, match="shows all its objects, so none can be added"):
        cut_and_paste(CutAndPasteCommand(dataset, tmp_path / "out"))
    with pytest.raises(ValueError, match="holds no pictures"):
        cut_and_paste(CutAndPasteCommand(dataset, tmp_path / "out", backgrounds=tmp_path))
    with pytest.raises(ValueError, match="out must be another folder"):
        cut_and_paste(CutAndPasteCommand(dataset, dataset))
    for options, message in (
        ({"images": 0}, "images must be at least 1"),
        ({"objects": (4, 3)}, "objects must rise"),
        ({"minimum_visibility": 0.0}, "minimum_visibility must be above 0"),
    ):
        with pytest.raises(ValueError, match=message):
            CutAndPasteCommand(dataset, tmp_path, **options)
