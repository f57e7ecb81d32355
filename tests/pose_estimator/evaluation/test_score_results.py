"""Scoring BOP result files: the truth is all correct, and missing estimates are wrong."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import solid_scenes
from two_view_pose.__main__ import main
from two_view_pose.core.geometry import make_transform
from two_view_pose.core.results import read_results
from two_view_pose.pose_estimator.bop.boxes import NO_BOX
from two_view_pose.pose_estimator.bop.dataset import BopAnnotation, read_dataset
from two_view_pose.pose_estimator.bop.objects import EvaluationObject
from two_view_pose.pose_estimator.bop.results import BopResult, write_bop_results
from two_view_pose.pose_estimator.bop.targets import BopTarget, read_targets, write_targets
from two_view_pose.pose_estimator.evaluation.score_results import score_results

CUBE = EvaluationObject(
    obj_id=5,
    name="cube",
    points=np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.05,
    diameter=0.1 * np.sqrt(3),
    symmetries=np.eye(4)[None],
)


@pytest.fixture(scope="module")
def solids(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("score") / "solids"
    solid_scenes.write_dataset(root)
    write_targets(read_dataset(root))
    return root


@pytest.fixture
def root(solids: Path, tmp_path: Path) -> Path:
    """The dataset, to be changed."""
    return Path(shutil.copytree(solids, tmp_path / "solids"))


def truth_of(root: Path, T_error: np.ndarray | None = None) -> list[BopResult]:
    T = np.eye(4) if T_error is None else T_error
    return [
        BopResult(image.scene_id, image.image_id, a.obj_id, 1.0, a.T_cam_obj @ T)
        for image in read_dataset(root)
        for a in image.annotations
    ]


def scored(root: Path, results: list[BopResult], *options: str) -> dict[tuple[str, str], float]:
    path, values = root.parent / "mine_solids-test.csv", root.parent / "values.json"
    write_bop_results(path, results)
    command = ["evaluate", "--data", str(root), "--score", str(path), "--json", str(values)]
    assert main([*command, *options]) == 0
    records = read_results(values)["records"]
    assert all(r["method"] == "mine" and r["dataset"] == "solids" for r in records)
    return {(r["metric"], r["object"]): r["value"] for r in records}


def at(x: float, visibility: float = 1.0) -> BopAnnotation:
    T = make_transform(np.eye(3), np.array([x, 0, 1.0]))
    return BopAnnotation(5, T, visibility, NO_BOX, NO_BOX, 0, 0)


def guess(x: float, score: float) -> BopResult:
    return BopResult(0, 0, 5, score, at(x).T_cam_obj)


def errors(results: list[BopResult], instances: list[BopAnnotation], count: int) -> list[float]:
    """Of the cube's instances, in meters: shifts along x are their own ADD."""
    found = score_results(results, [BopTarget(0, 0, 5, count)], {(0, 0): instances}, {5: CUBE})
    return [outcome.error * CUBE.diameter for outcome in found]


def test_the_truth_scores_exactly_one_hundred_percent(root, capsys):
    values = scored(root, truth_of(root))
    recalls = {name: value for (metric, name), value in values.items() if metric == "add_s_recall"}
    assert recalls == dict.fromkeys(["bracket", "stairs", "crate", "mean"], 1.0)
    assert max(v for (metric, _), v in values.items() if metric == "add_over_diameter") < 1e-9
    # A result file has no keypoints.
    assert {metric for metric, _ in values} == {"add_s_recall", "add_over_diameter"}
    printed = capsys.readouterr().out
    assert "0 targets have no estimate" in printed and "100.0 %" in printed
    assert "targets" in printed and "keypoints" not in printed


def test_what_is_missing_is_wrong_and_what_is_extra_does_not_count(root, capsys):
    targets = read_targets(read_dataset(root))
    results = [result for result in truth_of(root) if result.scene_id == 0]
    bracket = [t for t in targets if t.obj_id == 1]
    (root / "test_targets_bop19.json").write_text(
        json.dumps(
            [
                {"scene_id": t.scene_id, "im_id": t.image_id, "obj_id": 1, "inst_count": 1}
                for t in bracket
            ]
        )
    )
    values = scored(root, results)
    share = sum(t.scene_id == 0 for t in bracket) / len(bracket)
    assert values[("add_s_recall", "bracket")] == share == values[("add_s_recall", "mean")]
    assert values[("add_over_diameter", "mean")] == pytest.approx(1 - share)
    printed = capsys.readouterr().out
    assert f"{sum(t.scene_id == 3 for t in bracket)} targets have no estimate" in printed
    assert f"{sum(r.obj_id != 1 for r in results)} estimates are of no target" in printed


@pytest.mark.parametrize(("share", "recall"), [(0.095, 1.0), (0.105, 0.0)])
def test_the_threshold_is_a_tenth_of_the_datasets_diameter(root, share, recall):
    shift = make_transform(
        np.eye(3), np.array([0, share * solid_scenes.solid("stairs").diameter, 0])
    )
    values = scored(root, truth_of(root, shift))
    assert values[("add_over_diameter", "stairs")] == pytest.approx(share, rel=1e-6)
    assert values[("add_s_recall", "stairs")] == recall


def test_a_half_turn_is_right_for_the_symmetric_object_only(root):
    values = scored(root, truth_of(root, np.diag([-1.0, -1, 1, 1])))
    assert values[("add_s_recall", "crate")] == 1.0
    assert values[("add_s_recall", "stairs")] == 0.0


def test_without_a_list_every_visible_object_is_a_target(root):
    dataset = read_dataset(root)
    listed = read_targets(dataset)
    (root / "test_targets_bop19.json").unlink()
    assert read_targets(dataset) == listed
    assert scored(root, truth_of(root))[("add_s_recall", "mean")] == 1.0


def test_the_best_scores_count_as_often_as_there_are_instances():
    one = [at(0.0)]
    assert errors([guess(0.0, 0.1), guess(0.3, 0.9)], one, 1) == pytest.approx([0.3])
    two = [at(0.0), at(0.5)]
    assert errors([guess(0.51, 0.2), guess(0.02, 0.1)], two, 2) == pytest.approx([0.02, 0.01])
    # Both are nearest to the same instance; the one of higher score gets it.
    assert errors([guess(0.01, 0.1), guess(0.0, 0.9)], two, 2) == pytest.approx([0.0, 0.49])
    # A wrong pose of high score does not take an instance from a right one.
    assert errors([guess(0.1, 0.9), guess(0.0, 0.1)], two, 2) == pytest.approx([0.0, 0.4])
    assert errors([guess(0.5, 0.9)], two, 2) == [np.inf, pytest.approx(0.0)]
    # Of three instances the two most visible are to be found.
    hidden = [at(0.0, 0.05), at(0.5), at(1.0)]
    assert errors([guess(0.5, 0.9), guess(1.0, 0.8)], hidden, 2) == pytest.approx([0.0, 0.0])


def test_targets_without_truth_or_model_are_named():
    with pytest.raises(ValueError, match=r"image 0, object 5: scene_gt\.json has 1 of 2 poses"):
        errors([], [at(0.0)], 2)
    with pytest.raises(ValueError, match="object 6: the dataset has no model"):
        score_results([], [BopTarget(0, 0, 6, 1)], {(0, 0): [at(0.0)]}, {5: CUBE})


def test_wrong_calls_and_files_are_one_line(root, tmp_path, capsys):
    good = truth_of(root)
    write_bop_results(tmp_path / "a.csv", [*good, replace(good[0], image_id=99)])
    score = ["evaluate", "--score", str(tmp_path / "a.csv")]
    assert main([*score, "--data", str(root)]) == 2
    error = capsys.readouterr().err
    assert f"a.csv, line {len(good) + 2}: im_id 99 is not in the dataset" in error
    assert main(score) == 2
    assert "goes with --data" in capsys.readouterr().err
    (root / "test_targets_bop19.json").write_text('[{"scene_id": 0, "im_id": 0, "obj_id": 1}]')
    assert main([*score, "--data", str(root)]) == 2
    write_bop_results(tmp_path / "a.csv", good)
    assert main([*score, "--data", str(root)]) == 2
    assert "target 0: field 'inst_count' is missing" in capsys.readouterr().err
