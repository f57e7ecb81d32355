"""The evaluation: its arithmetic, and truth and garbage from end to end."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.bop import (
    BopDataset,
    read_dataset,
    read_depth,
    read_pairs,
    read_rgb,
)
from two_view_pose.pose_estimator.bop_pairs import BopPair, turned_round
from two_view_pose.pose_estimator.bop_results import read_bop_results
from two_view_pose.pose_estimator.bop_writer import write_pairs
from two_view_pose.pose_estimator.estimate import PoseEstimate
from two_view_pose.pose_estimator.evaluate import evaluate_dataset
from two_view_pose.pose_estimator.evaluate_config import EvaluateConfig
from two_view_pose.pose_estimator.evaluate_pairs import (
    distance_of_keypoints,
    evaluate_pairs,
    target_pairs,
)
from two_view_pose.pose_estimator.features import FeatureConfig
from two_view_pose.pose_estimator.geometry import (
    LINEMOD_K,
    View,
    make_transform,
    project,
    transform,
)
from two_view_pose.pose_estimator.outcomes import Outcome, print_table, summarise
from two_view_pose.pose_estimator.results import read_results
from two_view_pose.pose_estimator.told_regions import ToldRegions


class Oracle:
    """Knows the truth by the look of the picture, and errs by a fixed motion."""

    def __init__(self, dataset: BopDataset, objects, T_error: np.ndarray | None = None):
        self.objects = objects
        self.T_error = np.eye(4) if T_error is None else T_error
        self.asked: list[tuple[int, str]] = []
        self.told: list[tuple] = []
        self.truths = {}
        for image in dataset:
            for annotation in image.annotations:
                key = (read_rgb(image).tobytes(), annotation.obj_id)
                self.truths[key] = annotation.T_cam_obj

    @property
    def object_names(self) -> tuple[str, ...]:
        return tuple(self.objects)

    def estimate(self, views, object_name: str, *told) -> PoseEstimate:
        self.asked.append((len(views), object_name))
        self.told.append((views, *told))
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


@pytest.fixture(scope="module")
def dataset_with_depth(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset with a depth map for each picture, no two alike."""
    root = tmp_path_factory.mktemp("depth") / "boxes"
    shutil.copytree(dataset, root, ignore=shutil.ignore_patterns("packed*"))
    for number, picture in enumerate(sorted(root.glob("train_pbr/*/rgb/*"))):
        folder = picture.parent.parent / "depth"
        folder.mkdir(exist_ok=True)
        steps = np.full((480, 640), 1000 + number, np.uint16)
        cv2.imwrite(str(folder / f"{picture.stem}.png"), steps)
    return root


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
    asked: list[tuple] = []

    def load(method: str, weights: str, **options: Any) -> Oracle:
        asked.append((method, weights, options))
        return oracle

    monkeypatch.setattr("two_view_pose.pose_estimator.loading.load", load)
    target = tmp_path / "figures.json"
    config = EvaluateConfig(split="train_pbr", json=target)
    evaluate_dataset(config, dataset, {"dataset": "boxes"})
    document = read_results(target)
    assert json.loads(target.read_text())["seed"] == 1000
    assert figure(document["records"], "add_s_recall", "mean")["value"] == 1.0
    assert all(r["method"] == "mid" and r["dataset"] == "boxes" for r in document["records"])
    usual = {"preset": None, "solver": "soft", "device": "auto", "threads": 0}
    assert asked == [("mid", "linemod", usual)]
    printed = capsys.readouterr().out
    assert "100.0 %" in printed and "true pose" not in printed
    assert all("roi" not in r and "gap" not in r for r in document["records"])
    assert all(len(told) == 1 and told[0][0].depth is None for told in oracle.told)

    oracle.networks.features = SimpleNamespace(config=FeatureConfig())  # type: ignore[attr-defined]
    config = EvaluateConfig(split="train_pbr", json=target, roi="truth", solver="hard")
    evaluate_dataset(config, dataset, {"dataset": "boxes"})
    document = read_results(target)
    assert asked[-1] == ("mid", "linemod", {**usual, "solver": "hard"})
    assert all(r["roi"] == "truth" and r["solver"] == "hard" for r in document["records"])
    assert document["command"].endswith("--solver hard --roi truth")
    assert "regions of interest told: truth" in capsys.readouterr().out


def test_regions_of_interest_can_be_the_true_ones(opened, dataset, boxes):
    oracle = Oracle(opened, boxes)
    pairs = read_pairs(dataset)
    evaluate_pairs(oracle, opened, pairs, boxes, told=ToldRegions(1.4), progress=False)
    for pair, (views, rois) in zip(pairs, oracle.told, strict=True):
        scene = opened.scene(pair.scene_id)
        assert len(rois) == len(views) == 2
        for image_id, roi in zip((pair.ref_image_id, pair.second_image_id), rois, strict=True):
            image = scene[image_id]
            model = next(m for m in boxes.values() if m.obj_id == pair.target_obj_id)
            T = image.annotation(model.obj_id).T_cam_obj
            corners = project(transform(T, model.vertices), image.K)
            np.testing.assert_allclose(roi.centre, project(T[:3, 3], image.K), atol=1e-6)
            assert np.ptp(corners, axis=0).max() < roi.side < 2.5 * np.ptp(corners, axis=0).max()
    evaluate_pairs(oracle, opened, pairs[:1], boxes, views=1, told=ToldRegions(1.4), progress=False)
    assert [len(part) for part in oracle.told[-1]] == [1, 1]


def test_noise_of_told_regions_is_in_depth_and_sideways():
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 1.0]))
    views = [View(np.zeros((480, 640, 3), np.uint8), LINEMOD_K, np.eye(4))] * 2
    told = ToldRegions(1.4, depth_noise=0.04, side_noise=0.012)
    drawn = [told.regions([T, T], views, 0.1, number) for number in range(400)]
    depth = np.array([1.4 * 0.1 * LINEMOD_K[0, 0] / roi.side for rois in drawn for roi in rois])
    assert depth.mean() == pytest.approx(1.0, abs=0.01)
    assert depth.std() == pytest.approx(0.04, abs=0.004)
    pixels = np.array([roi.centre for rois in drawn for roi in rois]) - LINEMOD_K[:2, 2]
    spread = (pixels / LINEMOD_K[[0, 1], [0, 1]] * depth[:, None]).std(axis=0)
    np.testing.assert_allclose(spread, 0.012, atol=0.0015)
    # Each picture has noise of its own, and the same in every run.
    assert drawn[0][0].side != drawn[0][1].side
    assert told.regions([T, T], views, 0.1, 7)[1].side == drawn[7][1].side
    assert np.array_equal(T, make_transform(np.eye(3), np.array([0.0, 0.0, 1.0])))


def test_pairs_are_taken_both_ways(opened, dataset, boxes):
    pairs = read_pairs(dataset)
    oracle = Oracle(opened, boxes)  # checks the relative pose that it is told
    back = [turned_round(pair) for pair in pairs]
    outcomes = evaluate_pairs(oracle, opened, back, boxes, progress=False)
    assert len(outcomes) == len(pairs) and max(o.error for o in outcomes) < 1e-6
    first, second = pairs[0], turned_round(turned_round(pairs[0]))
    assert (first.ref_image_id, first.second_image_id) == (
        second.ref_image_id, second.second_image_id,
    )  # fmt: skip
    np.testing.assert_allclose(first.T_second_ref, second.T_second_ref, atol=1e-12)


def test_only_listed_targets_count_where_a_pair_names_none(boxes):
    first, second = boxes.values()
    pair = BopPair(3, 0, 1, np.eye(4), {first.obj_id: 20.0, second.obj_id: 30.0})
    named = replace(pair, target_obj_id=first.obj_id)
    listed = {(3, 0, second.obj_id), (3, 1, first.obj_id)}
    assert len(list(target_pairs([pair], boxes))) == 2
    assert [name for _, name in target_pairs([pair], boxes, listed)] == [second.name]
    assert [name for _, name in target_pairs([named], boxes, listed)] == [first.name]
    near = [name for _, name in target_pairs([pair], boxes, baselines=(10.0, 25.0))]
    assert near == [first.name]
    with pytest.raises(ValueError, match=r"baselines must rise within 0 to 180, got \(60"):
        EvaluateConfig(baselines=(60.0, 10.0))


def test_errors_are_measured_on_the_surfaces_that_are_given(opened, dataset, boxes):
    """Half a diameter on a mesh of twice the size is a quarter of it."""
    pairs = read_pairs(dataset)
    shifted = np.eye(4)
    shifted[2, 3] = 0.03
    oracle = Oracle(opened, boxes, shifted)
    plain = evaluate_pairs(oracle, opened, pairs, boxes, progress=False)
    twice = {
        name: replace(model, diameter=2 * model.diameter, symmetries=np.eye(4)[None])
        for name, model in boxes.items()
    }
    given = evaluate_pairs(oracle, opened, pairs, boxes, surfaces=twice, progress=False)
    for before, after in zip(plain, given, strict=True):
        model = boxes[before.object_name]
        assert after.error == pytest.approx(0.03 / (2 * model.diameter))
        assert before.error <= 0.03 / model.diameter + 1e-9


def test_depth_is_given_where_it_is_asked_for(dataset_with_depth, dataset, opened, boxes):
    with_depth = read_dataset(dataset_with_depth, "train_pbr")
    pairs = read_pairs(dataset_with_depth)[:2]
    for depth in (True, False):
        oracle = Oracle(with_depth, boxes)
        evaluate_pairs(oracle, with_depth, pairs, boxes, depth=depth, progress=False)
        assert oracle.told
        for pair, (views,) in zip(pairs, oracle.told, strict=True):
            scene = with_depth.scene(pair.scene_id)
            for view, number in zip(views, (pair.ref_image_id, pair.second_image_id), strict=True):
                if depth:
                    assert np.array_equal(view.depth, read_depth(scene[number]))
                else:
                    assert view.depth is None
    with pytest.raises(ValueError, match=r"has no depth maps.*--depth"):
        evaluate_pairs(
            Oracle(opened, boxes), opened, read_pairs(dataset), boxes, depth=True, progress=False
        )


def test_outcomes_keep_the_gap_and_are_summed_up_for_each(
    opened, dataset, boxes, monkeypatch, tmp_path
):
    pairs = [replace(p, gap=(1, 5)[i % 2]) for i, p in enumerate(read_pairs(dataset))]
    write_pairs(tmp_path / "pairs.json", pairs)
    outcomes = evaluate_pairs(Oracle(opened, boxes), opened, pairs, boxes, progress=False)
    assert [o.gap for o in outcomes] == [1, 5] * 3
    oracle = Oracle(opened, boxes)
    oracle.networks = type("Networks", (), {"objects": boxes})()  # type: ignore[attr-defined]
    monkeypatch.setattr("two_view_pose.pose_estimator.loading.load", lambda *a, **k: oracle)
    config = EvaluateConfig(split="train_pbr", pairs=tmp_path / "pairs.json")
    records = evaluate_dataset(config, dataset, {})
    counts = {
        r.get("gap"): r["n"]
        for r in records
        if r["metric"] == "add_s_recall" and r["object"] == "mean"
    }
    assert counts == {None: 6, 1: 3, 5: 3}


def test_poses_of_the_reference_views_are_written_once_each(
    opened, dataset, boxes, monkeypatch, tmp_path
):
    # Each brick is asked for with both second views; the estimator is surer of the latter.
    pairs = [replace(p, target_obj_id=boxes["brick"].obj_id) for p in read_pairs(dataset)]
    write_pairs(tmp_path / "pairs.json", pairs)
    oracle = Oracle(opened, boxes)
    oracle.networks = type("Networks", (), {"objects": boxes})()  # type: ignore[attr-defined]
    answer = oracle.estimate

    def estimate(views, name, *told):
        second = len(oracle.asked) % 2 == 1
        found = answer(views, name, *told)
        shift = make_transform(np.eye(3), np.array([0, 0, 0.0 if second else 0.01]))
        covariance = np.tile(np.eye(3), (9, 1, 1)) * (1e-6 if second else 1e-4)
        return PoseEstimate(shift @ found.T_cam_obj, found.keypoints, covariance, [])

    monkeypatch.setattr(oracle, "estimate", estimate)
    monkeypatch.setattr("two_view_pose.pose_estimator.loading.load", lambda *a, **k: oracle)
    target = tmp_path / "oracle_boxes-train_pbr.csv"
    config = EvaluateConfig(split="train_pbr", pairs=tmp_path / "pairs.json", csv=target)
    records = evaluate_dataset(config, dataset, {})
    assert figure(records, "add_s_recall", "mean")["n"] == 6
    results = read_bop_results(target)
    assert [result.target for result in results] == [(scene, 0, 3) for scene in range(3)]
    for result in results:
        truth = opened.scene(result.scene_id)[0].annotation(3)
        np.testing.assert_allclose(result.T_cam_obj, truth.T_cam_obj, atol=1e-9)
        assert result.score == 1.0 and result.seconds > 0


def test_the_table_names_every_object(capsys):
    print_table(summarise([outcome("cat", 0.01), outcome("duck", 0.4)], {}), "title")
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("cat", "duck", "mean", "100.0 %", "50.0 %"))


def test_a_dataset_without_pairs_is_paired_by_its_poses(
    dataset, boxes, monkeypatch, tmp_path, capsys
):
    for name in ("train_pbr", "models"):
        (tmp_path / name).symlink_to(dataset / name)
    oracle = Oracle(read_dataset(tmp_path, "train_pbr"), boxes)
    oracle.networks = type("Networks", (), {"objects": boxes})()  # type: ignore[attr-defined]
    monkeypatch.setattr("two_view_pose.pose_estimator.loading.load", lambda *a, **k: oracle)
    records = evaluate_dataset(EvaluateConfig(split="train_pbr"), tmp_path, {})
    # Three scenes of three pictures, all 10 to 60 degrees apart; two objects in each.
    assert "18 pairs of views found from the poses of" in capsys.readouterr().out
    mean = figure(records, "add_s_recall", "mean")
    assert mean["value"] == 1.0 and mean["n"] == 36
