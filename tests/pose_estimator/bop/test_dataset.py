"""BOP files: round trips, units on disk, and errors that name file and field."""

import json
import shutil

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import LINEMOD_K, make_transform
from two_view_pose.pose_estimator.bop import dataset as bop
from two_view_pose.pose_estimator.bop import writer as bop_writer
from two_view_pose.pose_estimator.bop.boxes import bounding_box


def random_pose(rng: np.random.Generator) -> np.ndarray:
    translation = rng.uniform((-1, -1, 0.5), (1, 1, 2.5))
    return make_transform(Rotation.random(rng=rng).as_matrix(), translation)


def random_frame(rng: np.random.Generator, objects: int = 2) -> bop_writer.BopFrame:
    masks = [np.zeros((48, 64), dtype=bool) for _ in range(objects)]
    for i, mask in enumerate(masks):
        mask[5 + i : 20, 10 : 30 + i] = True
    annotations = [
        bop.BopAnnotation(
            obj_id=5 + i,
            T_cam_obj=random_pose(rng),
            visibility=float(rng.uniform()),
            bbox_visib=bounding_box(mask),
            bbox_obj=(-4, 5, 60, 70),
            px_count_visib=int(mask.sum()),
            px_count_all=1000 + i,
        )
        for i, mask in enumerate(masks)
    ]
    return bop_writer.BopFrame(
        rgb=rng.integers(0, 256, (48, 64, 3), dtype=np.uint8),
        K=LINEMOD_K * [[0.1], [0.1], [1]],
        T_cam_world=random_pose(rng),
        annotations=annotations,
        masks=masks,
        depth=rng.uniform(0.5, 3, (48, 64)),
    )


@pytest.fixture
def dataset(tmp_path):
    """A dataset of two scenes with two images each, and the frames it was written from."""
    rng = np.random.default_rng(1)
    frames = {scene_id: [random_frame(rng), random_frame(rng)] for scene_id in (3, 12)}
    for scene_id, content in frames.items():
        bop_writer.write_scene(tmp_path, "train_pbr", scene_id, content, jpeg_quality=None)
    return tmp_path, frames


def test_scene_round_trip(dataset):
    root, frames = dataset
    images = list(bop.read_dataset(root, "train_pbr"))
    assert [(i.scene_id, i.image_id) for i in images] == [(3, 0), (3, 1), (12, 0), (12, 1)]
    for image, frame in zip(images, frames[3] + frames[12], strict=True):
        np.testing.assert_array_equal(bop.read_rgb(image), frame.rgb)
        np.testing.assert_allclose(bop.read_depth(image), frame.depth, atol=0.0501e-3)
        np.testing.assert_array_equal(image.K, frame.K)
        np.testing.assert_allclose(image.T_cam_world, frame.T_cam_world, atol=1e-9)
        assert len(image.annotations) == len(frame.annotations)
        for read, written, mask in zip(
            image.annotations, frame.annotations, frame.masks, strict=True
        ):
            np.testing.assert_allclose(read.T_cam_obj, written.T_cam_obj, atol=1e-9)
            np.testing.assert_array_equal(bop.read_mask(read), mask)
            for name in ("obj_id", "visibility", "bbox_visib", "bbox_obj", "px_count_all"):
                assert getattr(read, name) == getattr(written, name)
    assert images[0].annotation(6) is images[0].annotations[1]
    assert images[0].annotation(7) is None


def test_files_hold_millimeters_and_plain_bop(dataset):
    root, frames = dataset
    folder, frame = root / "train_pbr" / "000012", frames[12][1]
    pose = json.loads((folder / "scene_gt.json").read_text())["1"][0]
    np.testing.assert_allclose(pose["cam_t_m2c"], frame.annotations[0].T_cam_obj[:3, 3] * 1000)
    np.testing.assert_allclose(
        np.reshape(pose["cam_R_m2c"], (3, 3)), frame.annotations[0].T_cam_obj[:3, :3]
    )
    camera = json.loads((folder / "scene_camera.json").read_text())["1"]
    np.testing.assert_allclose(camera["cam_t_w2c"], frame.T_cam_world[:3, 3] * 1000)
    np.testing.assert_allclose(camera["cam_K"], frame.K.ravel())
    depth = cv2.imread(str(folder / "depth" / "000001.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    np.testing.assert_allclose(depth * camera["depth_scale"], frame.depth * 1000, atol=0.0501)
    mask = cv2.imread(str(folder / "mask_visib" / "000001_000000.png"), cv2.IMREAD_UNCHANGED)
    assert mask.shape == (48, 64) and set(np.unique(mask)) == {0, 255}
    info = json.loads((folder / "scene_gt_info.json").read_text())["1"][0]
    assert info["bbox_visib"] == [10, 5, 19, 14]  # bop_toolkit's width: last minus first column


def test_pairs_round_trip(tmp_path):
    rng = np.random.default_rng(2)
    pair = bop.BopPair(4, 0, 2, random_pose(rng), {9: 31.5, 1: 28.25}, target_obj_id=9)
    bop_writer.write_pairs(tmp_path / "two_view_pairs.json", [pair])
    (read,) = bop.read_pairs(tmp_path)
    np.testing.assert_allclose(read.T_second_ref, pair.T_second_ref, atol=1e-9)
    assert read.baseline_deg == 31.5 and read.obj_ids == (9, 1) and read.target_obj_id == 9
    assert (read.scene_id, read.ref_image_id, read.second_image_id) == (4, 0, 2)
    assert read.gap is None
    entry = json.loads((tmp_path / "two_view_pairs.json").read_text())[0]
    np.testing.assert_allclose(entry["cam_t_ref2second"], pair.T_second_ref[:3, 3] * 1000)


def test_pairs_round_trip_visible_fractions(tmp_path):
    path = tmp_path / "two_view_pairs.json"
    seen = {9: (0.5, 1.0), 1: (0.0, 0.25)}
    pairs = [bop.BopPair(0, 0, 1, np.eye(4), {9: 2.0, 1: 3.0}, visib_fracts=v) for v in (seen, {})]
    bop_writer.write_pairs(path, pairs)
    assert [dict(pair.visib_fracts) for pair in bop.read_pairs(tmp_path)] == [seen, {}]
    entries = json.loads(path.read_text())
    assert entries[0]["visib_fracts"] == {"9": [0.5, 1.0], "1": [0.0, 0.25]}
    assert "visib_fracts" not in entries[1]
    path.write_text(json.dumps([entries[0] | {"visib_fracts": {"9": [0.5]}}]))
    with pytest.raises(ValueError, match="pair 0, visible fractions: field '9' must be 2 numbers"):
        bop.read_pairs(path)


def test_pairs_round_trip_gap(tmp_path):
    path = tmp_path / "two_view_pairs.json"
    pairs = [bop.BopPair(0, 3, 3 + gap, np.eye(4), {1: 2.0}, gap=gap) for gap in (1, 5, 10)]
    bop_writer.write_pairs(path, pairs)
    assert [pair.gap for pair in bop.read_pairs(tmp_path)] == [1, 5, 10]
    assert [entry["gap"] for entry in json.loads(path.read_text())] == [1, 5, 10]


@pytest.mark.parametrize("gap", [0, -1, 1.5, "5", True])
def test_invalid_gap_is_reported(tmp_path, gap):
    path = tmp_path / "two_view_pairs.json"
    bop_writer.write_pairs(path, [bop.BopPair(0, 0, 1, np.eye(4), {1: 2.0}, gap=1)])
    path.write_text(json.dumps([json.loads(path.read_text())[0] | {"gap": gap}]))
    with pytest.raises(ValueError, match="pair 0: field 'gap' must be an integer >= 1"):
        bop.read_pairs(path)


def test_pairs_of_recorded_scenes_are_read(tmp_path):
    T = random_pose(np.random.default_rng(3))
    T_mm = T.copy()
    T_mm[:3, 3] *= 1000
    recorded = {"im_a": 3, "im_b": 38, "T_b_a_mm": np.round(T_mm, 6).tolist()}
    recorded["objects"] = {"1": {"baseline_deg": 20.0}, "6": {"baseline_deg": 30.0}}
    path = tmp_path / "pairs.json"
    path.write_text(json.dumps({"scene_id": 2, "pairs": [recorded]}))
    (pair,) = bop.read_pairs(path)
    np.testing.assert_allclose(pair.T_second_ref, T, atol=1e-5)
    assert (pair.scene_id, pair.ref_image_id, pair.second_image_id) == (2, 3, 38)
    assert pair.obj_ids == (1, 6) and pair.baseline_deg == 25.0 and pair.target_obj_id is None


def test_rounded_rotations_become_orthonormal(dataset):
    root, frames = dataset
    path = root / "train_pbr" / "000003" / "scene_gt.json"
    content = json.loads(path.read_text())
    content["0"][0]["cam_R_m2c"] = np.round(content["0"][0]["cam_R_m2c"], 3).tolist()
    path.write_text(json.dumps(content))
    rotation = bop.read_dataset(root, "train_pbr").scene(3)[0].annotations[0].T_cam_obj[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation, frames[3][0].annotations[0].T_cam_obj[:3, :3], atol=1e-3)


BROKEN = [
    ("scene_gt.json", lambda c: c["1"][0].pop("cam_t_m2c"), "image 1, annotation 0.*'cam_t_m2c'"),
    ("scene_gt.json", lambda c: c["1"][1]["cam_R_m2c"].pop(), "'cam_R_m2c' must be 9 numbers"),
    ("scene_gt.json", lambda c: c["0"][1].update(obj_id="x"), "annotation 1: field 'obj_id'"),
    (
        "scene_gt.json",
        lambda c: c["0"][0]["cam_t_m2c"].__setitem__(1, float("nan")),
        "image 0, annotation 0: field 'cam_t_m2c' is NaN, infinite",
    ),
    (
        "scene_gt.json",
        lambda c: c["0"][0]["cam_R_m2c"].__setitem__(0, 3.0),
        "image 0, annotation 0: field 'cam_R_m2c' is not rigid",
    ),
    ("scene_gt.json", lambda c: c.update({"7": []}), "image 7: an annotated image has no camera"),
    ("scene_gt_info.json", lambda c: c.pop("1"), "image 1: .*no list for 2"),
    ("scene_gt_info.json", lambda c: c["0"].pop(), "image 0: .*1 entries for 2"),
    ("scene_gt_info.json", lambda c: c["0"][1].pop("visib_fract"), "'visib_fract' is missing"),
    ("scene_camera.json", lambda c: c["1"].pop("cam_K"), "image 1: field 'cam_K' is missing"),
    ("scene_camera.json", lambda c: c["1"].pop("cam_t_w2c"), "'cam_t_w2c' is missing"),
    (
        "scene_camera.json",
        lambda c: c["1"]["cam_K"].__setitem__(0, -1.0),
        "image 1: field 'cam_K' must have positive focal",
    ),
]


@pytest.mark.parametrize(("name", "damage", "message"), BROKEN)
def test_invalid_field_is_reported(dataset, name, damage, message):
    root, _ = dataset
    path = root / "train_pbr" / "000012" / name
    content = json.loads(path.read_text())
    damage(content)
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=message) as error:
        list(bop.read_dataset(root, "train_pbr"))
    assert name in str(error.value)


def test_missing_and_truncated_files_are_reported(dataset):
    root, _ = dataset
    data = bop.read_dataset(root, "train_pbr")
    image = data.scene(3)[0]
    image.rgb_path.write_bytes(image.rgb_path.read_bytes()[:20])
    with pytest.raises(ValueError, match=r"000000\.png is a truncated or damaged image"):
        bop.read_rgb(image)
    image.annotations[1].mask_visib_path.unlink()
    with pytest.raises(ValueError, match=r"annotation 1: a mask is missing .*000000_000001\.png"):
        data.scene(3)
    path = root / "train_pbr" / "000012" / "scene_camera.json"
    path.write_text(path.read_text()[:40])
    with pytest.raises(ValueError, match=r"scene_camera\.json is not valid JSON"):
        data.scene(12)
    path.unlink()
    with pytest.raises(ValueError, match=r"scene_camera\.json is missing"):
        data.scene(12)
    with pytest.raises(ValueError, match="scene 4 is not in"):
        data.scene(4)
    with pytest.raises(ValueError, match="no split 'test'"):
        bop.read_dataset(root)
    (root / "test").mkdir()
    with pytest.raises(ValueError, match="holds no scenes"):
        bop.read_dataset(root)


def test_writing_validates_poses_and_masks(tmp_path):
    frame = random_frame(np.random.default_rng(0))
    T = frame.annotations[0].T_cam_obj.copy()
    frame.annotations[0].T_cam_obj[0, 3] = np.nan
    with pytest.raises(ValueError, match="T_cam_obj of object 5 in scene 1, image 0 has NaN"):
        bop_writer.write_scene(tmp_path, "test", 1, [frame])
    frame.annotations[0].T_cam_obj[:] = T
    frame.masks.pop()
    with pytest.raises(ValueError, match=r"masks of scene 1, image 0 must be 2"):
        bop_writer.write_scene(tmp_path, "test", 1, [frame])
    with pytest.raises(ValueError, match="holds no scenes"):  # nothing half-written is left visible
        bop.read_dataset(tmp_path)
    bop_writer.write_scene(tmp_path, "test", 1, [random_frame(np.random.default_rng(0))])
    with pytest.raises(ValueError, match="scene 1 exists already"):
        bop_writer.write_scene(tmp_path, "test", 1, [])


def test_boxes_and_visibility_come_from_masks_without_gt_info(dataset):
    root, frames = dataset
    folder = root / "train_pbr" / "000003"
    (folder / "scene_gt_info.json").unlink()
    (folder / "mask").mkdir()
    whole = np.zeros((48, 64), np.uint8)
    whole[5:20, 10:50] = 255
    cv2.imwrite(str(folder / "mask" / "000000_000000.png"), whole)
    image = bop.read_dataset(root, "train_pbr").scene(3)[0]
    for read, written in zip(image.annotations, frames[3][0].annotations, strict=True):
        assert read.bbox_visib == written.bbox_visib
        assert read.px_count_visib == written.px_count_visib
        np.testing.assert_allclose(read.T_cam_obj, written.T_cam_obj, atol=1e-9)
    first, second = image.annotations
    assert first.visibility == 0.5 and first.bbox_obj == (10, 5, 39, 14)  # 20 of 40 columns
    assert first.px_count_all == 600
    assert second.visibility == 1.0 and second.bbox_obj == (-1, -1, -1, -1)


def test_objects_count_as_visible_without_gt_info_and_masks(dataset):
    root, _ = dataset
    folder = root / "train_pbr" / "000003"
    (folder / "scene_gt_info.json").unlink()
    shutil.rmtree(folder / "mask_visib")
    for annotation in bop.read_dataset(root, "train_pbr").scene(3)[0].annotations:
        assert annotation.visibility == 1.0 and annotation.mask_visib_path is None
        assert annotation.bbox_visib == annotation.bbox_obj == (-1, -1, -1, -1)
        assert annotation.px_count_visib == annotation.px_count_all == -1


def test_gray_images_and_images_without_annotations_are_read(dataset):
    root, _ = dataset
    folder = root / "train_pbr" / "000003"
    (folder / "rgb").rename(folder / "gray")
    for path in sorted((folder / "gray").iterdir()):
        cv2.imwrite(str(path.with_suffix(".jpg")), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
        path.unlink()
    for name in ("scene_gt.json", "scene_gt_info.json"):
        content = json.loads((folder / name).read_text())
        del content["1"]
        (folder / name).write_text(json.dumps(content))
    scene = bop.read_dataset(root, "train_pbr").scene(3)
    assert sorted(scene) == [0, 1] and scene[1].annotations == ()
    rgb = bop.read_rgb(scene[0])
    assert rgb.shape == (48, 64, 3) and (rgb[..., 0] == rgb[..., 2]).all()
