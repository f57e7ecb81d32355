"""The evaluation: its arithmetic, and truth and garbage from end to end."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator import evaluate
from two_view_pose.pose_estimator.bop import BopDataset, read_dataset, read_pairs
from two_view_pose.pose_estimator.bop_pairs import BopPair
from two_view_pose.pose_estimator.estimate import PoseEstimate
from two_view_pose.pose_estimator.evaluate import (
    EvaluateConfig,
    Outcome,
    distance_of_keypoints,
    evaluate_dataset,
    evaluate_pairs,
    print_table,
    summarise,
    target_pairs,
)
from two_view_pose.pose_estimator.geometry import make_transform, transform
from two_view_pose.pose_estimator.results import read_results


class Oracle:
    """Knows the truth by the look of the picture, and errs by a fixed motion."""

    def __init__(self, dataset: BopDataset, objects, T_error: np.ndarray | None = None):
        self.objects = objects
        self.T_error = np.eye(4) if T_error is None else T_error
        self.asked: list[tuple[int, str]] = []
        self.truths = {}
        for image in dataset:
            for annotation in image.annotations:
                key = (evaluate.read_rgb(image).tobytes(), annotation.obj_id)
                self.truths[key] = annotation.T_cam_obj

    @property
    def object_names(self) -> tuple[str, ...]:
        return tuple(self.objects)

    def estimate(self, views, object_name: str) -> PoseEstimate:
        self.asked.append((len(views), object_name))
        model = self.objects[object_name]
        truth = self.truths[views[0].image.tobytes(), model.obj_id]
        if len(views) == 2:
            # The relative pose that the estimator is told leads to the second picture's truth.
            other = self.truths[views[1].image.tobytes(), model.obj_id]
            T_second_ref = views[1].T_cam_world @ np.linalg.inv(views[0].T_cam_world)
            assert np.allclose(T_second_ref @ truth, other, atol=1e-5)
        T = truth @ self.T_error
        return PoseEstimate(T, transform(T, model.keypoints), np.zeros((9, 3, 3)), [])


@pytest.fixture(scope="module")
def opened(dataset: Path) -> BopDataset:
    return read_dataset(dataset, "train_pbr")


def outcome(name: str, error: float, seconds: float = 0.1) -> Outcome:
    return Outcome(name, error, error / 10, seconds, 30.0, 1.0, 0.9)


def figure(records: list[dict], metric: str, name: str) -> dict:
    (record,) = [r for r in records if r["metric"] == metric and r.get("object") == name]
    return record


def test_summarise_averages_over_objects_not_over_pairs():
    outcomes = [outcome("a", e) for e in (0.05, 0.15, 0.099, 3.0)] + [outcome("b", 0.01, 0.5)]
    records = summarise(outcomes, {"method": "mid", "scene": "linemod"})
    a, b, mean = (figure(records, "add_s_recall", name) for name in ("a", "b", "mean"))
    assert (a["value"], b["value"], mean["value"]) == (0.5, 1.0, 0.75)
    assert (a["n"], b["n"], mean["n"]) == (4, 1, 5)
    expected = np.mean([0.05, 0.15, 0.099, 1.0])  # errors are capped at a diameter
    assert figure(records, "add_over_diameter", "a")["value"] == pytest.approx(expected)
    assert figure(records, "keypoint_distance", "b")["unit"] == "m"
    (seconds,) = [r for r in records if r["metric"] == "seconds_per_pair"]
    assert seconds["value"] == 0.1 and seconds["unit"] == "s"
    assert all(r["method"] == "mid" and r["scene"] == "linemod" for r in records)
    assert all(r["low"] <= r["value"] <= r["high"] for r in records if "low" in r)


def test_the_interval_of_the_mean_is_about_the_mean():
    # Many easy pairs of one object, few hard ones of another: the mean is over the objects.
    outcomes = [outcome("a", 0.01)] * 200 + [outcome("b", 0.5)] * 5
    mean = figure(summarise(outcomes, {}), "add_s_recall", "mean")
    assert mean["value"] == 0.5
    assert mean["low"] <= 0.5 <= mean["high"]


def test_nothing_to_evaluate_is_an_error():
    with pytest.raises(ValueError, match="no pair of views"):
        summarise([], {})


def test_pairs_without_a_target_count_for_every_known_object(boxes):
    pair = BopPair(0, 0, 1, np.eye(4), {3: 10.0, 7: 20.0, 99: 5.0})
    assert [name for _, name in target_pairs([pair], boxes)] == ["brick", "crate"]
    named = BopPair(0, 0, 1, np.eye(4), {3: 10.0, 7: 20.0}, target_obj_id=7)
    assert [name for _, name in target_pairs([named], boxes)] == ["crate"]
    unknown = BopPair(0, 0, 1, np.eye(4), {99: 5.0}, target_obj_id=99)
    assert list(target_pairs([unknown], boxes)) == []


def test_the_truth_has_recall_one(opened, dataset, boxes):
    oracle = Oracle(opened, boxes)
    outcomes = evaluate_pairs(oracle, opened, read_pairs(dataset), boxes, progress=False)
    assert oracle.asked == [(2, "brick"), (2, "crate")] * 3
    assert max(o.error for o in outcomes) < 1e-6
    assert max(o.keypoint_distance for o in outcomes) < 1e-6
    assert {o.baseline for o in outcomes} == {20.0} and {o.visibility for o in outcomes} == {1.0}
    records = summarise(outcomes, {})
    assert figure(records, "add_s_recall", "mean")["value"] == 1.0


def test_garbage_has_recall_none(opened, dataset, boxes):
    far = make_transform(np.eye(3), np.array([0.0, 0.0, 0.3]))
    outcomes = evaluate_pairs(
        Oracle(opened, boxes, far), opened, read_pairs(dataset), boxes, progress=False
    )
    records = summarise(outcomes, {})
    assert figure(records, "add_s_recall", "mean")["value"] == 0.0
    assert figure(records, "add_over_diameter", "mean")["value"] == 1.0


def test_one_view_can_be_left_out(opened, dataset, boxes):
    oracle = Oracle(opened, boxes)
    evaluate_pairs(oracle, opened, read_pairs(dataset), boxes, views=1, progress=False)
    assert {views for views, _ in oracle.asked} == {1}


@pytest.mark.parametrize(("share", "recall"), [(0.095, 1.0), (0.105, 0.0)])
def test_the_threshold_is_a_tenth_of_the_diameter(opened, dataset, boxes, share, recall):
    # A shift moves all points of the brick by the same distance: ADD is its length.
    shift = make_transform(np.eye(3), np.array([share * boxes["brick"].diameter, 0, 0]))
    pairs = [p for p in read_pairs(dataset) if p.target_obj_id == boxes["brick"].obj_id]
    outcomes = evaluate_pairs(Oracle(opened, boxes, shift), opened, pairs, boxes, progress=False)
    assert outcomes[0].error == pytest.approx(share)
    assert figure(summarise(outcomes, {}), "add_s_recall", "brick")["value"] == recall


def test_half_a_turn_is_right_for_the_symmetric_object_only(opened, dataset, boxes):
    turn = make_transform(Rotation.from_euler("z", 180, degrees=True).as_matrix(), np.zeros(3))
    outcomes = evaluate_pairs(
        Oracle(opened, boxes, turn), opened, read_pairs(dataset), boxes, progress=False
    )
    for o in outcomes:
        model = boxes[o.object_name]
        if o.object_name == "crate":
            # ADD-S on samples of the surface: not zero, but small.
            assert o.error < 0.1 and o.keypoint_distance < 1e-6
        else:
            moved = transform(turn, model.points)
            add = np.linalg.norm(moved - model.points, axis=1).mean() / model.diameter
            assert o.error == pytest.approx(add) and o.error > 0.1


def test_keypoints_are_compared_with_the_nearest_equivalent(boxes):
    model = boxes["crate"]
    T = make_transform(Rotation.from_euler("xyz", [0.1, 1, 2]).as_matrix(), np.array([0, 0, 1.0]))
    keypoints = transform(T @ model.symmetries[1], model.keypoints) + np.array([0, 0, 0.01])
    assert distance_of_keypoints(keypoints, T, model) == pytest.approx(0.01)


def test_a_dataset_is_evaluated_and_written(opened, dataset, boxes, monkeypatch, tmp_path, capsys):
    oracle = Oracle(opened, boxes)
    oracle.networks = type("Networks", (), {"objects": boxes})()  # type: ignore[attr-defined]
    monkeypatch.setattr("two_view_pose.pose_estimator.load", lambda method, weights: oracle)
    target = tmp_path / "figures.json"
    config = EvaluateConfig(split="train_pbr", json=target)
    evaluate_dataset(config, dataset, {"dataset": "boxes"})
    document = read_results(target)
    assert json.loads(target.read_text())["seed"] == 1000
    assert figure(document["records"], "add_s_recall", "mean")["value"] == 1.0
    assert all(r["method"] == "mid" and r["dataset"] == "boxes" for r in document["records"])
    assert "100.0 %" in capsys.readouterr().out


def test_the_table_names_every_object(capsys):
    print_table(summarise([outcome("cat", 0.01), outcome("duck", 0.4)], {}), "title")
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("cat", "duck", "mean", "100.0 %", "50.0 %"))
