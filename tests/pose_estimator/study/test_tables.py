"""The study's records, against results computed by hand."""

import pytest
from helpers.study_cases import only_record, outcome
from two_view_pose.pose_estimator.study.plan import NOISY, Run
from two_view_pose.pose_estimator.study.tables import (
    difference_records,
    method_records,
    noise_records,
    solver_records,
    tables,
    training_records,
)

OUTCOMES = [
    outcome(0, "cat", 1, 0.05, 0.010),
    outcome(1, "cat", 1, 0.15, 0.020),
    outcome(0, "duck", 1, 2.00, 0.300),
    outcome(0, "cat", 10, 0.05, 0.004),
    outcome(1, "cat", 10, 0.099, 0.006),
    outcome(0, "duck", 10, 0.20, 0.050),
    outcome(1, "duck", 10, 0.02, 0.010),
]


def test_recalls_and_distances_by_object_and_gap():
    records = method_records(OUTCOMES, {"method": "mid", "scene": "linemod"})
    recall = "add_s_recall"
    assert only_record(records, recall, object="cat", gap=1)["value"] == 0.5
    assert only_record(records, recall, object="duck", gap=10)["value"] == 0.5
    assert only_record(records, recall, object="mean", gap=1)["value"] == pytest.approx(
        (0.5 + 0) / 2
    )
    assert only_record(records, recall, object="mean", gap=10)["value"] == pytest.approx(
        (1 + 0.5) / 2
    )
    distance = "keypoint_distance"
    at_1 = (0.015 + 0.300) / 2
    at_10 = (0.005 + 0.030) / 2
    assert only_record(records, distance, object="mean", gap=1)["value"] == pytest.approx(at_1)
    assert only_record(records, distance, object="mean", gap=10)["value"] == pytest.approx(at_10)
    mean = only_record(records, distance, object="mean", gap="mean")
    assert mean["value"] == pytest.approx((at_1 + at_10) / 2)
    assert (mean["n"], mean["sequences"], mean["unit"]) == (7, 2, "m")
    # An error counts as a diameter at most.
    over = only_record(records, "add_over_diameter", object="duck", gap=1)
    assert over["value"] == 1.0
    assert only_record(records, "keypoint_distance_median", gap=1)["value"] == pytest.approx(0.020)
    assert all(r["method"] == "mid" and r["scene"] == "linemod" for r in records)
    assert all(r["low"] <= r["value"] <= r["high"] for r in records if "low" in r)


def test_keypoints_found_by_the_distance_between_the_cameras():
    near, far = 0.03, 0.09
    outcomes = [
        outcome(0, "cat", 10, distance=0.029, camera=near),
        outcome(1, "cat", 10, distance=0.031, camera=near),
        outcome(2, "cat", 10, distance=0.100, camera=far),
        outcome(3, "duck", 10, distance=0.001, camera=near),
        outcome(4, "cat", 1, distance=0.001, camera=far),
    ]
    records = method_records(outcomes, {"method": "mid", "scene": "linemod"})
    recall = "keypoint_recall"
    assert only_record(records, recall, object="cat", baseline=0.0375)["value"] == 0.5
    # All gaps count together.
    assert only_record(records, recall, object="cat", baseline=0.0875)["value"] == 0.5
    mean = only_record(records, recall, object="mean", baseline=0.0375)
    assert mean["value"] == pytest.approx(0.75)


def test_recall_by_visibility_and_capped_distances():
    outcomes = [
        outcome(0, "cat", 10, 0.05, distance=0.02, visibility=0.2),
        outcome(1, "cat", 10, 0.50, distance=0.90, visibility=0.3),
        outcome(2, "cat", 10, 0.05, distance=0.03, visibility=0.9),
    ]
    records = method_records(outcomes, {"method": "mid", "scene": "occlusion"})
    recall = "visibility_add_s_recall"
    assert only_record(records, recall, visibility=0.1)["value"] == 0.5
    assert only_record(records, recall, visibility=0.7)["n"] == 1
    capped = only_record(records, "capped_keypoint_distance", gap=10)
    assert capped["value"] == pytest.approx((0.02 + 0.1 + 0.03) / 3)


def test_differences_are_of_the_same_pairs():
    mid = [outcome(s, "cat", 10, e) for s, e in ((0, 0.05), (1, 0.05), (2, 0.5))]
    rgbd = [outcome(s, "cat", 10, e) for s, e in ((0, 0.5), (1, 0.05), (9, 0.5))]
    records = difference_records(mid, rgbd, {"method": "mid", "against": "rgbd", "scene": "x"})
    gain = only_record(records, "add_s_recall_difference", gap=10)
    assert gain["value"] == pytest.approx(0.5)  # of scenes 0 and 1
    assert gain["n"] == 2 and gain["low"] < 0 < 0.9 < gain["high"]  # two pairs prove nothing
    assert difference_records(mid, [outcome(7)], {}) == []


def test_solvers_on_the_same_keypoints():
    outcomes = [
        outcome(s, "cat", 10, solvers={"soft": soft, "kabsch": kabsch, "hard": 0.05})
        for s, soft, kabsch in ((0, 0.05, 0.2), (1, 0.05, 0.05), (2, 0.05, 0.3), (3, 0.3, 0.09))
    ]
    records = solver_records(outcomes, {"method": "mid", "scene": "occlusion"})
    assert only_record(records, "solver_recall", solver="soft")["value"] == 0.75
    assert only_record(records, "solver_recall", solver="kabsch")["value"] == 0.5
    gain = only_record(records, "solver_recall_difference", against="kabsch")
    assert gain["value"] == 0.25 and gain["solver"] == "soft" and gain["low"] <= 0 < gain["high"]
    assert only_record(records, "solver_recall_difference", against="hard")["value"] == -0.25
    assert solver_records([outcome()], {}) == []


def test_noise_and_trainings():
    noisy = noise_records([outcome(0, error=0.05), outcome(1, error=0.5)], {"rotation_deg": 2.0})
    assert only_record(noisy, "noise_add_s_recall", rotation_deg=2.0)["value"] == 0.5
    baseline = [outcome(s, error=e) for s, e in ((0, 0.05), (1, 0.05), (5, 0.9))]
    other = [outcome(s, error=e) for s, e in ((0, 0.05), (1, 0.4))]
    records = training_records(other, baseline, {"training": "no pose loss"})
    recall = "training_add_s_recall"
    assert only_record(records, recall, training="no pose loss")["value"] == 0.5
    assert only_record(records, recall, paired_with="no pose loss")["value"] == 1.0
    assert only_record(records, f"{recall}_difference")["value"] == 0.5
    assert len(training_records(other, [], {"training": "no pose loss"})) == 2


def test_ablations_have_their_own_metrics():
    """A query for the recall of mid finds one record for each object and gap."""
    outcomes = {
        Run("main", "linemod", "mid"): OUTCOMES,
        Run("main", "linemod", "late"): OUTCOMES,
        Run("training", "linemod", "mid", NOISY, (10,)): OUTCOMES,
        Run("noise", "linemod", "mid", NOISY, (10,), rotation=1.0): OUTCOMES,
        Run("noise", "linemod", "mid", "", (10,), rotation=1.0): OUTCOMES,
    }
    records = tables(outcomes)
    only_record(records, "add_s_recall", method="mid", scene="linemod", object="mean", gap=10)
    gain = only_record(records, "add_s_recall_difference", method="mid", against="late", gap=10)
    assert gain["value"] == 0.0
    only_record(records, "noise_add_s_recall", method="mid", training=NOISY, rotation_deg=1.0)
    only_record(records, "training_add_s_recall", training=NOISY, gap=10)
