"""Selection of pairs, and errors of the relative pose."""

from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.bop.pairs import BopPair
from two_view_pose.pose_estimator.study.plan import (
    DEFAULT_WEIGHTS,
    NOISY,
    Run,
    choose_pairs,
    perturbed_pose,
    plan,
)


def pair(scene: int, reference: int, gap: int | None, target: int = 3) -> BopPair:
    T = np.eye(4)
    T[:3, 3] = 0.01 * (gap or 1), 0.0, 0.0
    return BopPair(scene, reference, reference + (gap or 1), T, {3: 5.0, 7: 6.0}, target, gap)


def test_pairs_are_selected_by_gap_and_object(boxes):
    pairs = [pair(s, r, g, t) for s in (1, 0) for r in (0, 20) for g in (1, 5, 10) for t in (3, 7)]
    chosen = choose_pairs(Run("main", "linemod", "mid", gaps=(1, 10)), [*pairs, pair(0, 0, None)],
                          boxes)  # fmt: skip
    assert len(chosen) == 16
    assert {p.gap for p, _ in chosen} == {1, 10}
    assert Counter(name for _, name in chosen) == {"brick": 8, "crate": 8}
    assert [p.scene_id for p, _ in chosen] == sorted(p.scene_id for p, _ in chosen)


def test_limited_pairs_are_spread_evenly(boxes):
    pairs = [pair(0, reference, gap) for reference in range(100) for gap in (1, 10)]
    run = Run("main", "linemod", "mid", gaps=(1, 10), per_object=4)
    chosen = [p.ref_image_id for p, _ in choose_pairs(run, pairs, boxes) if p.gap == 10]
    assert chosen == [12, 37, 62, 87]
    both = [pair(s, 0, 10, t) for s in range(10) for t in (3, 7)]
    few = choose_pairs(Run("main", "linemod", "mid", per_gap=4), both, boxes)
    assert Counter(name for _, name in few) == {"brick": 2, "crate": 2}


@pytest.mark.parametrize(("rotation", "translation"), [(0.0, 0.0), (1.5, 0.0), (2.0, 0.01)])
def test_perturbed_pose_has_the_error_of_the_run(rotation, translation):
    given = pair(4, 7, 10)
    run = Run("noise", "linemod", "mid", rotation=rotation, translation=translation)
    noisy = perturbed_pose(run, given, seed=3)
    error = noisy @ np.linalg.inv(given.T_second_ref)
    angle = Rotation.from_matrix(error[:3, :3]).magnitude()
    assert np.degrees(angle) == pytest.approx(rotation, abs=1e-6)
    assert np.linalg.norm(error[:3, 3]) == pytest.approx(translation, abs=1e-9)
    assert np.array_equal(noisy, perturbed_pose(run, given, seed=3))


def test_pose_errors_differ_in_magnitude_only():
    def error(given: BopPair, rotation: float, seed: int = 0) -> np.ndarray:
        noisy = perturbed_pose(Run("noise", "linemod", "mid", rotation=rotation), given, seed)
        return Rotation.from_matrix((noisy @ np.linalg.inv(given.T_second_ref))[:3, :3]).as_rotvec()

    assert np.allclose(2 * error(pair(0, 0, 10), 1.0), error(pair(0, 0, 10), 2.0), atol=1e-9)
    assert not np.allclose(error(pair(0, 0, 10), 1.0), error(pair(0, 1, 10), 1.0), atol=1e-4)
    assert not np.allclose(error(pair(0, 0, 10), 1.0), error(pair(0, 0, 10), 1.0, 1), atol=1e-4)


def test_other_weights_have_a_limit_of_their_own():
    runs = list(plan(("mid", "late"), [DEFAULT_WEIGHTS, "paper"], other_per_object=7))
    assert {u.per_object for u in runs if u.part == "training"} == {7}
    assert {u.per_object for u in runs if u.part == "main"} == {0}


def test_plan_has_only_the_given_methods():
    assert {u.method for u in plan(("late",), [DEFAULT_WEIGHTS])} == {"late"}
    assert {u.part for u in plan(("rgbd",), [DEFAULT_WEIGHTS, NOISY])} == {"main"}
