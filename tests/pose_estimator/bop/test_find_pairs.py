"""Pairs found from world poses or objects have the true motion; moved objects are excluded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import invert, make_transform
from two_view_pose.pose_estimator.bop.dataset import (
    BopAnnotation,
    BopDataset,
    BopImage,
    read_dataset,
)
from two_view_pose.pose_estimator.bop.find_pairs import find_pairs, pairs_of_scene
from two_view_pose.pose_estimator.bop.pairs import read_pairs

HALF_TURN = np.stack([np.eye(4), np.diag([-1.0, -1, 1, 1])])


def camera(azimuth: float, distance: float = 1.0) -> np.ndarray:
    """T_cam_world of a camera that looks at the origin from the horizon at an angle in degrees."""
    a = np.radians(azimuth)
    out = np.array([np.cos(a), np.sin(a), 0])
    right = np.cross(-out, (0, 0, 1))
    rotation = np.stack([right, np.cross(-out, right), -out])
    return make_transform(rotation, np.array([0, 0, distance]))


def scene(
    angles: list[float], objects: dict[int, np.ndarray], world: bool = True
) -> list[BopImage]:
    images = []
    for i, angle in enumerate(angles):
        T = camera(angle)
        annotations = tuple(
            BopAnnotation(obj_id, T @ T_world_obj, 1.0, (0, 0, 9, 9), (0, 0, 9, 9), 80, 80)
            for obj_id, T_world_obj in objects.items()
        )
        images.append(
            BopImage(2, i, Path("x"), None, 1.0, np.eye(3), T if world else None, annotations)
        )
    return images


def placed(x: float, y: float, z: float, angle: float = 0.3) -> np.ndarray:
    return make_transform(
        Rotation.from_euler("xyz", [angle, 1, 2]).as_matrix(), np.array([x, y, z])
    )


def changed(image: BopImage, obj_id: int, T_cam_obj: np.ndarray, **more: float) -> BopImage:
    annotations = tuple(
        replace(a, T_cam_obj=T_cam_obj, **more) if a.obj_id == obj_id else a
        for a in image.annotations
    )
    return replace(image, annotations=annotations)


OBJECTS = {1: placed(0, 0, 0), 5: placed(0.1, 0.05, 0), 9: placed(-0.1, 0, 0.05)}
ANGLES = [0.0, 20.0, 50.0]


@pytest.mark.parametrize("world", [True, False])
def test_motion_and_baseline_are_the_cameras(world):
    pairs = pairs_of_scene(scene(ANGLES, {1: OBJECTS[1]} | OBJECTS, world), {})
    assert len(pairs) == 6
    for pair in pairs:
        first, second = (camera(ANGLES[i]) for i in (pair.ref_image_id, pair.second_image_id))
        np.testing.assert_allclose(pair.T_second_ref, second @ invert(first), atol=1e-9)
        assert pair.obj_ids == (1, 5, 9) and pair.scene_id == 2 and pair.target_obj_id is None
        # Object 1 is where all cameras look.
        angle = abs(ANGLES[pair.ref_image_id] - ANGLES[pair.second_image_id])
        assert pair.baselines_deg[1] == pytest.approx(angle, abs=1e-6)


@pytest.mark.parametrize("world", [True, False])
def test_moved_object_is_excluded(world):
    images = scene([0.0, 30.0], OBJECTS, world)
    T = images[1].annotation(5).T_cam_obj  # type: ignore[union-attr]
    images[1] = changed(images[1], 5, make_transform(T[:3, :3], T[:3, 3] + [0.02, 0, 0]))
    for pair in pairs_of_scene(images, {}):
        assert pair.obj_ids == (1, 9)
    assert len(pairs_of_scene(images, {})) == 2


def test_without_world_poses_two_objects_must_agree_and_a_single_one_is_used():
    images = scene([0.0, 30.0], {1: OBJECTS[1], 5: OBJECTS[5]}, world=False)
    assert len(pairs_of_scene(images, {})) == 2
    T = images[1].annotation(5).T_cam_obj  # type: ignore[union-attr]
    images[1] = changed(images[1], 5, T @ placed(0.03, 0, 0))
    assert pairs_of_scene(images, {}) == []
    single = scene([0.0, 30.0], {1: OBJECTS[1]}, world=False)
    assert len(pairs_of_scene(single, {})) == 2


def test_symmetric_object_may_have_any_equivalent_pose():
    images = scene([0.0, 30.0], OBJECTS, world=False)
    T = images[1].annotation(5).T_cam_obj  # type: ignore[union-attr]
    images[1] = changed(images[1], 5, T @ HALF_TURN[1])
    found = pairs_of_scene(images, {5: HALF_TURN})
    assert [pair.obj_ids for pair in found] == [(1, 5, 9)] * 2
    assert [pair.obj_ids for pair in pairs_of_scene(images, {})] == [(1, 9)] * 2
    # It also proposes the camera motion, as one of two objects.
    both = [
        replace(image, annotations=tuple(a for a in image.annotations if a.obj_id != 9))
        for image in images
    ]
    expected = camera(30) @ invert(camera(0))
    (pair, _) = pairs_of_scene(both, {5: HALF_TURN})
    np.testing.assert_allclose(pair.T_second_ref, expected, atol=1e-9)
    assert pair.obj_ids == (1, 5)


def test_duplicated_object_is_excluded():
    images = scene([0.0, 30.0], OBJECTS)
    twin = replace(images[0].annotations[0], T_cam_obj=camera(0) @ placed(0.2, 0, 0))
    images[0] = replace(images[0], annotations=(*images[0].annotations, twin))
    assert {pair.obj_ids for pair in pairs_of_scene(images, {})} == {(5, 9)}


def test_objects_occluded_in_the_reference_view_are_excluded():
    images = scene([0.0, 30.0], OBJECTS)
    T = images[0].annotation(5).T_cam_obj  # type: ignore[union-attr]
    images[0] = changed(images[0], 5, T, visibility=0.05)
    found = {pair.ref_image_id: pair.obj_ids for pair in pairs_of_scene(images, {})}
    assert found == {0: (1, 9), 1: (1, 5, 9)}


def test_pairs_are_spread_over_baselines_and_deterministic():
    images = scene(list(np.arange(0, 180, 3.0)), OBJECTS, world=False)
    pairs = pairs_of_scene(images, {})
    first = [pair for pair in pairs if pair.ref_image_id == 0]
    assert len(first) == 4
    assert all(10 <= pair.baseline_deg <= 60 for pair in pairs)
    low, second, third, high = (pair.baseline_deg for pair in first)
    assert low < 20 < second < 35 < third < 48 < high
    again = pairs_of_scene(images, {})
    assert [(p.ref_image_id, p.second_image_id) for p in pairs] == [
        (p.ref_image_id, p.second_image_id) for p in again
    ]


def test_long_scenes_are_subsampled():
    images = scene(list(np.linspace(0, 100, 300)), {1: OBJECTS[1]})
    paired = {pair.ref_image_id for pair in pairs_of_scene(images, {})}
    assert 150 < len(paired) <= 200 and {0, 299} <= paired


def test_gaps_pair_images_by_their_numbers():
    """Not by their places; image 3 is missing, and the object has moved in image 6."""
    images = scene(list(np.linspace(0, 7, 8)), {1: OBJECTS[1]})
    images[6] = changed(images[6], 1, camera(6.0) @ placed(0.2, 0, 0))
    pairs = pairs_of_scene([i for i in images if i.image_id != 3], {}, gaps=(1, 5))
    assert [(p.ref_image_id, p.second_image_id, p.gap) for p in pairs] == [
        (0, 1, 1), (0, 5, 5), (1, 2, 1), (2, 7, 5), (4, 5, 1),
    ]  # fmt: skip
    for pair in pairs:
        assert pair.baselines_deg[1] == pytest.approx(pair.gap, abs=1e-6)
    many = scene(list(np.linspace(0, 90, 500)), {1: OBJECTS[1]})
    references = [p.ref_image_id for p in pairs_of_scene(many, {}, gaps=(1,))]
    assert len(references) == 199 and references[-1] > 490


def test_no_image_at_a_gap_is_an_error(dataset: Path):
    with pytest.raises(ValueError, match="whose numbers differ by 700"):
        find_pairs(read_dataset(dataset, "train_pbr"), gaps=(700,))


def test_pairs_file_has_priority(dataset: Path, tmp_path: Path):
    opened = read_dataset(dataset, "train_pbr")
    listed = read_pairs(dataset)
    assert [p.second_image_id for p in find_pairs(opened)] == [p.second_image_id for p in listed]
    bare = tmp_path / "bare"
    bare.mkdir()
    for name in ("train_pbr", "models"):
        (bare / name).symlink_to(dataset / name)
    found = find_pairs(read_dataset(bare, "train_pbr"))
    known = {(p.scene_id, p.ref_image_id, p.second_image_id): p for p in found}
    for pair in listed:
        same = known[pair.scene_id, pair.ref_image_id, pair.second_image_id]
        np.testing.assert_allclose(same.T_second_ref, pair.T_second_ref, atol=1e-6)


def test_no_pairs_is_an_error(dataset: Path, tmp_path: Path):
    (tmp_path / "train_pbr").symlink_to(dataset / "train_pbr")
    opened = read_dataset(tmp_path, "train_pbr")
    with pytest.raises(ValueError, match=r"no two_view_pairs\.json, and no two images"):
        find_pairs(BopDataset(opened.root, opened.split, ()))
