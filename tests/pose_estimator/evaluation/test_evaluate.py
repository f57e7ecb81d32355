"""Evaluating a dataset from its options to the results file, with an oracle method."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from helpers.study_cases import Oracle, only_record
from two_view_pose.core.errors import InputError
from two_view_pose.core.geometry import make_transform
from two_view_pose.core.results import read_results
from two_view_pose.pose_estimator.bop.dataset import BopDataset, read_dataset, read_pairs
from two_view_pose.pose_estimator.bop.results import read_bop_results
from two_view_pose.pose_estimator.bop.writer import write_pairs
from two_view_pose.pose_estimator.evaluation.config import EvaluateConfig
from two_view_pose.pose_estimator.evaluation.evaluate import evaluate_dataset
from two_view_pose.pose_estimator.evaluation.evaluate_pairs import evaluate_pairs
from two_view_pose.pose_estimator.networks.features import FeatureConfig
from two_view_pose.pose_estimator.types import PoseEstimate


@pytest.fixture(scope="module")
def opened(dataset: Path) -> BopDataset:
    return read_dataset(dataset, "train_pbr")


@pytest.fixture
def loaded(boxes, monkeypatch):
    """Makes an oracle that ``load`` returns; returns it and the list of calls of ``load``."""

    def replace_load(dataset: BopDataset) -> tuple[Oracle, list[tuple]]:
        oracle, calls = Oracle(dataset, boxes), []
        oracle.networks = SimpleNamespace(objects=boxes)

        def load(method: str, weights: str, **options):
            calls.append((method, weights, options))
            return oracle

        monkeypatch.setattr("two_view_pose.pose_estimator.fusion.loading.load", load)
        return oracle, calls

    return replace_load


def test_a_dataset_is_evaluated_and_written(opened, dataset, loaded, tmp_path, capsys):
    oracle, asked = loaded(opened)
    target = tmp_path / "results.json"
    config = EvaluateConfig(split="train_pbr", json=target)
    evaluate_dataset(config, dataset, {"dataset": "boxes"})
    document = read_results(target)
    assert json.loads(target.read_text())["seed"] == 1000
    assert only_record(document["records"], "add_s_recall", object="mean")["value"] == 1.0
    assert all(r["method"] == "mid-pnp" and r["dataset"] == "boxes" for r in document["records"])
    usual = {
        "preset": None, "solver": None, "refine": None, "device": "auto", "threads": 0
    }  # fmt: skip
    assert asked == [("mid-pnp", "linemod", usual)]
    printed = capsys.readouterr().out
    assert "100.0 %" in printed and "true pose" not in printed
    assert all("roi" not in r and "gap" not in r for r in document["records"])
    assert all(len(request) == 2 and request[0][0].depth is None for request in oracle.requests)

    oracle.networks.features = SimpleNamespace(config=FeatureConfig())  # type: ignore[attr-defined]
    config = EvaluateConfig(split="train_pbr", json=target, roi="truth", solver="hard")
    evaluate_dataset(config, dataset, {"dataset": "boxes"})
    document = read_results(target)
    assert asked[-1] == ("mid-pnp", "linemod", {**usual, "solver": "hard"})
    assert all(r["roi"] == "truth" and r["solver"] == "hard" for r in document["records"])
    assert document["command"].endswith("--solver hard --roi truth")
    assert "ground-truth ROI: truth" in capsys.readouterr().out


def test_outcomes_are_summarized_by_gap(opened, dataset, boxes, loaded, tmp_path):
    pairs = [replace(p, gap=(1, 5)[i % 2]) for i, p in enumerate(read_pairs(dataset))]
    write_pairs(tmp_path / "pairs.json", pairs)
    outcomes = evaluate_pairs(Oracle(opened, boxes), opened, pairs, boxes, progress=False)
    assert [o.gap for o in outcomes] == [1, 5] * 3
    loaded(opened)
    config = EvaluateConfig(split="train_pbr", pairs=tmp_path / "pairs.json")
    records = evaluate_dataset(config, dataset, {})
    counts = {
        r.get("gap"): r["n"]
        for r in records
        if r["metric"] == "add_s_recall" and r["object"] == "mean"
    }
    assert counts == {None: 6, 1: 3, 5: 3}


def test_poses_of_the_reference_views_are_written_once_each(
    opened, dataset, boxes, loaded, monkeypatch, tmp_path
):
    # Each brick is asked for with both second views; the latter has the smaller variance.
    pairs = [replace(p, target_obj_id=boxes["brick"].obj_id) for p in read_pairs(dataset)]
    write_pairs(tmp_path / "pairs.json", pairs)
    oracle, _ = loaded(opened)
    answer = oracle.estimate

    def estimate(views, name, *rois):
        second = len(oracle.asked) % 2 == 1
        found = answer(views, name, *rois)
        shift = make_transform(np.eye(3), np.array([0, 0, 0.0 if second else 0.01]))
        covariance = np.tile(np.eye(3), (9, 1, 1)) * (1e-6 if second else 1e-4)
        return PoseEstimate(shift @ found.T_cam_obj, found.keypoints, covariance, [])

    monkeypatch.setattr(oracle, "estimate", estimate)
    target = tmp_path / "oracle_boxes-train_pbr.csv"
    config = EvaluateConfig(split="train_pbr", pairs=tmp_path / "pairs.json", csv=target)
    records = evaluate_dataset(config, dataset, {})
    assert only_record(records, "add_s_recall", object="mean")["n"] == 6
    results = read_bop_results(target)
    assert [result.target for result in results] == [(scene, 0, 3) for scene in range(3)]
    for result in results:
        truth = opened.scene(result.scene_id)[0].annotation(3)
        np.testing.assert_allclose(result.T_cam_obj, truth.T_cam_obj, atol=1e-9)
        assert result.score == 1.0 and result.seconds > 0


def test_what_is_left_out_is_said(opened, dataset, boxes, loaded, tmp_path, capsys):
    """The dataset's crate is another object than the weights' of that number."""
    oracle, _ = loaded(opened)
    crate = replace(boxes["crate"], vertices=1.3 * boxes["crate"].vertices)
    other = replace(boxes["brick"], name="other", obj_id=55)
    oracle.networks.objects = {"brick": boxes["brick"], "crate": crate, "other": other}
    pairs = read_pairs(dataset)
    free = [replace(pair, target_obj_id=None) for pair in pairs[:2]]
    write_pairs(tmp_path / "pairs.json", [*free, *pairs[2:]])
    config = EvaluateConfig(
        split="train_pbr", data=dataset, pairs=tmp_path / "pairs.json", baselines=(0, 30)
    )
    records = evaluate_dataset(config, dataset, {})
    assert {r["object"] for r in records if "object" in r} == {"brick", "mean"}
    printed = " ".join(capsys.readouterr().out.split())
    assert "crate is left out: object 7 of the dataset is 141 mm across" in printed
    assert "not in the dataset: other (55)" in printed
    # Both pairs without a target, and one of the other two scenes each.
    assert "4 times in a pair, of object 7, which is not among those to estimate" in printed
    evaluate_dataset(replace(config, baselines=(10, 30)), dataset, {})
    assert "degrees apart" not in capsys.readouterr().out
    with pytest.raises(InputError, match=r"no pair of views .*crate is left out: object 7 of"):
        evaluate_dataset(replace(config, baselines=(30, 40)), dataset, {})


def test_rendered_scenes_have_the_surface_that_the_weights_lack(
    opened, dataset, boxes, loaded, capsys
):
    """Weights of objects that must not be redistributed; the mesh comes with --objects."""
    oracle, _ = loaded(opened)
    oracle.networks.objects = {
        name: replace(model, points=np.empty((0, 3))) for name, model in boxes.items()
    }
    records = evaluate_dataset(EvaluateConfig(split="train_pbr"), dataset, {})
    assert only_record(records, "add_s_recall", object="mean")["value"] == 1.0
    assert "left out" not in capsys.readouterr().out


def test_a_given_mesh_is_the_surface_where_a_dataset_has_no_models(
    opened, dataset, boxes, loaded, tmp_path
):
    (tmp_path / "train_pbr").symlink_to(dataset / "train_pbr")
    oracle, _ = loaded(opened)
    bare = {"brick": replace(boxes["brick"], points=np.empty((0, 3)))}
    oracle.networks.objects = bare
    write_pairs(tmp_path / "two_view_pairs.json", read_pairs(dataset)[:1])
    config = EvaluateConfig(split="train_pbr", data=tmp_path)
    with pytest.raises(InputError, match=r"ADD needs the surface of brick.*--objects brick=FILE"):
        evaluate_dataset(config, tmp_path, {})
    for extents, words in (((120, 80, 60), ""), ((120, 60, 80), "brick is 156 mm across")):
        mesh = tmp_path / "mesh.ply"
        trimesh.creation.box(extents).export(mesh)
        given = replace(config, objects=(f"brick={mesh}",))
        if words:
            with pytest.raises(InputError, match=words):
                evaluate_dataset(given, tmp_path, {})
        else:
            records = evaluate_dataset(given, tmp_path, {})
            assert only_record(records, "add_s_recall", object="brick")["value"] == 1.0
    with pytest.raises(InputError, match="--objects mesh is not what the weights know: brick"):
        evaluate_dataset(replace(config, objects=(str(mesh),)), tmp_path, {})


@pytest.mark.slow
def test_a_dataset_without_pairs_is_paired_by_its_poses(dataset, loaded, tmp_path, capsys):
    for name in ("train_pbr", "models"):
        (tmp_path / name).symlink_to(dataset / name)
    loaded(read_dataset(tmp_path, "train_pbr"))
    records = evaluate_dataset(EvaluateConfig(split="train_pbr"), tmp_path, {})
    # Three scenes of three images, all 10 to 60 degrees apart; two objects in each.
    assert "18 pairs of views found from the poses of" in capsys.readouterr().out
    mean = only_record(records, "add_s_recall", object="mean")
    assert mean["value"] == 1.0 and mean["n"] == 36
