"""Equivalent poses get one label, and symmetries permute keypoints."""

import numpy as np
from scipy.spatial.transform import Rotation
from two_view_pose import assets
from two_view_pose.core.geometry import make_transform, transform
from two_view_pose.pose_estimator.symmetry import canonical_pose, keypoint_permutations


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return make_transform(
        Rotation.random(rng=rng).as_matrix(), rng.uniform((-0.2, -0.2, 0.8), (0.2, 0.2, 1.2))
    )


def test_all_equivalent_poses_have_one_canonical_pose(boxes):
    symmetries = boxes["crate"].symmetries
    rng = np.random.default_rng(0)
    for _ in range(20):
        T = random_pose(rng)
        expected = canonical_pose(T, symmetries)
        assert any(np.allclose(expected, T @ S) for S in symmetries)
        for S in symmetries:
            assert np.allclose(canonical_pose(T @ S, symmetries), expected)


def test_a_rotation_about_the_viewing_axis_does_not_change_the_label(boxes):
    symmetries = boxes["crate"].symmetries
    rng = np.random.default_rng(1)
    for _ in range(20):
        T = random_pose(rng)
        roll = make_transform(Rotation.from_euler("z", rng.uniform(0, 6)).as_matrix(), np.zeros(3))
        expected = roll @ canonical_pose(T, symmetries)
        assert np.allclose(canonical_pose(roll @ T, symmetries), expected)


def test_an_object_without_symmetry_keeps_its_pose(boxes):
    T = random_pose(np.random.default_rng(2))
    assert np.array_equal(canonical_pose(T, boxes["brick"].symmetries), T)


def test_permutations_renumber_the_keypoints_of_an_equivalent_pose(boxes):
    model = boxes["crate"]
    permutations = keypoint_permutations(model.keypoints, model.symmetries)
    assert len(permutations) == 2 and np.array_equal(permutations[0], np.arange(9))
    T = random_pose(np.random.default_rng(3))
    for S, permutation in zip(model.symmetries, permutations, strict=True):
        moved = transform(T @ S, model.keypoints)
        assert np.allclose(moved, transform(T, model.keypoints)[permutation], atol=1e-9)


def test_a_symmetry_that_the_keypoints_do_not_share_is_left_out(boxes):
    model = boxes["crate"]
    keypoints = model.keypoints.copy()
    keypoints[0] += 0.01
    assert len(keypoint_permutations(keypoints, model.symmetries)) == 1


def test_the_symmetric_objects_of_linemod_have_permutations():
    for name in ("eggbox", "glue"):
        model = assets.load_object(name)
        permutations = keypoint_permutations(model.keypoints, model.symmetries)
        assert len(permutations) == len(model.symmetries) > 1
