"""Running an estimator on pairs of views: what it is given, and how its errors are measured."""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.study_cases import Oracle, only_record
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import make_transform, transform
from two_view_pose.pose_estimator.bop.dataset import (
    BopDataset,
    read_dataset,
    read_depth,
    read_pairs,
)
from two_view_pose.pose_estimator.bop.pairs import BopPair, swapped
from two_view_pose.pose_estimator.evaluation.config import EvaluateConfig
from two_view_pose.pose_estimator.evaluation.evaluate_pairs import evaluate_pairs, target_pairs
from two_view_pose.pose_estimator.evaluation.outcomes import summarize


@pytest.fixture(scope="module")
def opened(dataset: Path) -> BopDataset:
    return read_dataset(dataset, "train_pbr")


@pytest.fixture(scope="module")
def dataset_with_depth(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset with a depth map for each image, no two alike."""
    root = tmp_path_factory.mktemp("depth") / "boxes"
    shutil.copytree(dataset, root, ignore=shutil.ignore_patterns("packed*"))
    for number, image in enumerate(sorted(root.glob("train_pbr/*/rgb/*"))):
        folder = image.parent.parent / "depth"
        folder.mkdir(exist_ok=True)
        steps = np.full((480, 640), 1000 + number, np.uint16)
        cv2.imwrite(str(folder / f"{image.stem}.png"), steps)
    return root


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
    records = summarize(outcomes, {})
    assert only_record(records, "add_s_recall", object="mean")["value"] == 1.0


def test_wrong_poses_have_recall_zero(opened, dataset, boxes):
    far = make_transform(np.eye(3), np.array([0.0, 0.0, 0.3]))
    outcomes = evaluate_pairs(
        Oracle(opened, boxes, far), opened, read_pairs(dataset), boxes, progress=False
    )
    records = summarize(outcomes, {})
    assert only_record(records, "add_s_recall", object="mean")["value"] == 0.0
    assert only_record(records, "add_over_diameter", object="mean")["value"] == 1.0


@pytest.mark.parametrize(("share", "recall"), [(0.095, 1.0), (0.105, 0.0)])
def test_the_threshold_is_a_tenth_of_the_diameter(opened, dataset, boxes, share, recall):
    # A shift moves all points of the brick by the same distance: ADD is its length.
    shift = make_transform(np.eye(3), np.array([share * boxes["brick"].diameter, 0, 0]))
    pairs = [p for p in read_pairs(dataset) if p.target_obj_id == boxes["brick"].obj_id]
    outcomes = evaluate_pairs(Oracle(opened, boxes, shift), opened, pairs, boxes, progress=False)
    assert outcomes[0].error == pytest.approx(share)
    assert only_record(summarize(outcomes, {}), "add_s_recall", object="brick")["value"] == recall


def test_a_half_turn_is_right_for_the_symmetric_object_only(opened, dataset, boxes):
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


def test_swapped_pairs_are_evaluated(opened, dataset, boxes):
    pairs = read_pairs(dataset)
    oracle = Oracle(opened, boxes)  # checks the relative pose that it is given
    back = [swapped(pair) for pair in pairs]
    outcomes = evaluate_pairs(oracle, opened, back, boxes, progress=False)
    assert len(outcomes) == len(pairs) and max(o.error for o in outcomes) < 1e-6
    first, second = pairs[0], swapped(swapped(pairs[0]))
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
    for wrong in ({"gaps": (0,), "data": Path("x")}, {"gaps": (1,)}):
        with pytest.raises(ValueError, match="gaps must be 1 or more and need --data"):
            EvaluateConfig(**wrong)


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
        assert oracle.requests
        for pair, (views, _) in zip(pairs, oracle.requests, strict=True):
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
