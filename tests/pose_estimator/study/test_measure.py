"""Runs of the study: the input of a method, its errors, and resuming."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.study_cases import Oracle
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import make_transform, transform
from two_view_pose.pose_estimator.bop.dataset import read_dataset, read_pairs
from two_view_pose.pose_estimator.methods import SOLVERS
from two_view_pose.pose_estimator.solvers.rigid import solve_pose
from two_view_pose.pose_estimator.study.log import OutcomeLog
from two_view_pose.pose_estimator.study.measure import (
    Measurement,
    StudySet,
    compare_with_truth,
    measure_runs,
)
from two_view_pose.pose_estimator.study.plan import Run
from two_view_pose.pose_estimator.types import PoseEstimate

MID = Run("main", "linemod", "mid")


@pytest.fixture(scope="module")
def study_set(dataset: Path) -> StudySet:
    """The flat images as a test: of each scene, gap 1 for the brick and 10 for the crate."""
    pairs = [replace(p, gap=1 if p.second_image_id == 1 else 10) for p in read_pairs(dataset)]
    return StudySet("linemod", read_dataset(dataset, "train_pbr"), tuple(pairs))


def measure(run, oracle, study_set, boxes, path, **options):
    log = OutcomeLog(path, {})
    measure_runs([Measurement(run, oracle, log)], study_set, boxes, progress=False, **options)
    return log.outcomes


def test_ground_truth_has_no_error(study_set, boxes, tmp_path):
    oracle = Oracle(study_set.dataset, boxes)
    outcomes = measure(MID, oracle, study_set, boxes, tmp_path / "a")
    assert oracle.asked == [(2, "brick"), (2, "crate")] * 3
    assert [(o.gap, o.object_name) for o in outcomes] == [(1, "brick"), (10, "crate")] * 3
    assert max(o.error for o in outcomes) < 1e-5
    assert max(o.keypoint_distance for o in outcomes) < 1e-5
    for o, pair in zip(outcomes, study_set.pairs, strict=True):
        assert set(o.solver_errors) == set(SOLVERS)
        assert max(o.solver_errors.values()) < 1e-4
        assert o.camera_baseline == np.linalg.norm(pair.T_second_ref[:3, 3]) > 0.1


def test_errors_of_a_shifted_pose(study_set, boxes, tmp_path):
    shift = make_transform(np.eye(3), np.array([0.0, 0.012, 0.0]))
    outcomes = measure(
        MID, Oracle(study_set.dataset, boxes, shift), study_set, boxes, tmp_path / "a"
    )
    brick = outcomes[0]
    assert brick.error == pytest.approx(0.012 / boxes["brick"].diameter, abs=1e-5)
    assert brick.distances == pytest.approx([0.012] * 9, abs=1e-6)


@pytest.mark.slow
def test_an_interrupted_run_resumes(study_set, boxes, tmp_path):
    class Stopped(Oracle):
        def estimate(self, views, object_name):
            if len(self.asked) == 4:
                raise KeyboardInterrupt
            return super().estimate(views, object_name)

    first = Stopped(study_set.dataset, boxes)
    with pytest.raises(KeyboardInterrupt):
        measure(MID, first, study_set, boxes, tmp_path / "a")
    second = Oracle(study_set.dataset, boxes)
    outcomes = measure(MID, second, study_set, boxes, tmp_path / "a")
    assert len(second.asked) == 2
    complete = measure(MID, Oracle(study_set.dataset, boxes), study_set, boxes, tmp_path / "b")
    assert outcomes == complete


def test_methods_of_a_group_are_given_the_same_views(study_set, boxes, tmp_path):
    """Of what is logged already, nothing is measured again."""
    late = replace(MID, method="late")
    measure(late, Oracle(study_set.dataset, boxes), study_set, boxes, tmp_path / "late")
    oracles = [Oracle(study_set.dataset, boxes) for _ in range(3)]
    runs = [MID, replace(MID, method="pnp"), late]
    group = [
        Measurement(run, oracle, OutcomeLog(tmp_path / run.method, {}))
        for run, oracle in zip(runs, oracles, strict=True)
    ]
    measure_runs(group, study_set, boxes, progress=False)
    mid, pnp, again = ([views for views, _ in oracle.requests] for oracle in oracles)
    assert len(mid) == len(pnp) == 6 and again == []
    for first, second in zip(mid, pnp, strict=True):
        assert all(a is b for a, b in zip(first, second, strict=True))
    assert group[0].log.outcomes == group[1].log.outcomes == group[2].log.outcomes


def test_single_view_methods_run_once_per_reference(study_set, boxes, tmp_path):
    pairs = [replace(p, target_obj_id=None) for p in study_set.pairs]
    both = replace(study_set, pairs=tuple(pairs))
    oracle = Oracle(study_set.dataset, boxes)
    outcomes = measure(Run("main", "linemod", "single"), oracle, both, boxes, tmp_path / "a")
    assert len(outcomes) == 12
    assert oracle.asked == [(1, "brick"), (1, "crate")] * 3
    assert all(o.solver_errors == {} for o in outcomes)


@pytest.mark.slow
def test_only_rgbd_is_given_depth(study_set, boxes, tmp_path, monkeypatch):
    depth = np.ones((480, 640), np.float32)
    monkeypatch.setattr(
        "two_view_pose.pose_estimator.evaluation.evaluate_pairs.read_depth", lambda image: depth
    )
    for method, seen in (("rgbd", [True]), ("mid", [False, False]), ("single", [False])):
        oracle = Oracle(study_set.dataset, boxes)
        measure(Run("main", "linemod", method), oracle, study_set, boxes, tmp_path / method)
        given = [[view.depth is not None for view in views] for views, _ in oracle.requests]
        assert given == [seen] * 6


def test_rgbd_without_depth_maps_is_an_error(study_set, boxes, tmp_path):
    oracle = Oracle(study_set.dataset, boxes)
    with pytest.raises(ValueError, match="no depth map"):
        measure(Run("main", "linemod", "rgbd"), oracle, study_set, boxes, tmp_path / "a")


def test_the_perturbed_pose_reaches_the_method(study_set, boxes, tmp_path):
    noisy = replace(MID, part="noise", rotation=2.0, translation=0.01)
    oracle = Oracle(study_set.dataset, boxes, strict=False)
    measure(noisy, oracle, study_set, boxes, tmp_path / "a", seed=5)
    for given, pair in zip(oracle.relative_poses, study_set.pairs, strict=True):
        error = given @ np.linalg.inv(pair.T_second_ref)
        assert np.degrees(Rotation.from_matrix(error[:3, :3]).magnitude()) == pytest.approx(2.0)


def test_a_run_without_pairs_is_an_error(study_set, boxes, tmp_path):
    with pytest.raises(ValueError, match="no pair"):
        measure(replace(MID, gaps=(7,)), Oracle(study_set.dataset, boxes), study_set, boxes,
            tmp_path / "a")  # fmt: skip


def test_pairs_without_a_gap_are_an_error(dataset):
    with pytest.raises(ValueError, match="without a gap"):
        StudySet.open("linemod", dataset, "train_pbr")


def test_solvers_take_all_keypoints_alike(boxes):
    model = boxes["brick"]
    truth = make_transform(np.eye(3), np.array([0.0, 0.0, 1.0]))
    keypoints = transform(truth, model.keypoints)
    keypoints[0] += 0.03
    covariance = np.tile(1e-8 * np.eye(3), (9, 1, 1))
    covariance[0] *= 1e6
    T = solve_pose(model.keypoints, keypoints, model.diameter, "soft")
    estimate = PoseEstimate(T, keypoints, covariance)
    found = compare_with_truth(estimate, truth, model, solvers=True)
    assert found["solver_errors"]["soft"] == pytest.approx(found["error"], abs=1e-6)
    # Least squares is biased by the outlier.
    assert found["solver_errors"]["kabsch"] > 0.01 > found["solver_errors"]["hard"]
    assert found["distances"][0] == pytest.approx(0.03 * np.sqrt(3))
