"""Time per pair, one at a time and in a batch."""

import numpy as np
from two_view_pose.core.geometry import LINEMOD_K, View
from two_view_pose.pose_estimator.study.cost import BATCH, measure_cost
from two_view_pose.pose_estimator.types import PoseEstimate


class Single:
    """Records the number of views of each request."""

    object_names = ("cat",)

    def __init__(self) -> None:
        self.asked: list[list[int]] = []

    def estimate(self, views, object_name: str) -> PoseEstimate:
        self.asked.append([len(views)])
        return PoseEstimate(np.eye(4), np.zeros((9, 3)), np.zeros((9, 3, 3)))


class Batched(Single):
    def estimate_batch(self, requests) -> list[PoseEstimate]:
        answers = [self.estimate(*request) for request in requests]
        self.asked[-len(requests) :] = [[len(views) for views, _ in requests]]
        return answers


def pairs(count: int):
    def make(number: int):
        image = np.full((4, 4, 3), number, np.uint8)
        views = {"single": 1, "mid": 2}
        return lambda method: ([View(image, LINEMOD_K, np.eye(4))] * views[method], "cat")

    return [make(number) for number in range(count)]


def test_all_methods_are_timed_in_turn():
    estimators = {"single": Batched(), "mid": Batched()}
    records = measure_cost(estimators, pairs(3), repeats=2, progress=False)
    found = [(r["method"], r["batch"]) for r in records]
    assert found == [("single", 1), ("single", BATCH), ("mid", 1), ("mid", BATCH)]
    assert all(r["metric"] == "seconds_per_pair" and r["value"] > 0 for r in records)
    # The single view gets one view, and the batches are full.
    assert estimators["single"].asked == [[1]] * 4 + [[1] * BATCH] * 3
    assert estimators["mid"].asked == [[2]] * 4 + [[2] * BATCH] * 3


def test_methods_without_batches_are_timed_one_at_a_time():
    estimator = Single()
    records = measure_cost({"mid": estimator}, pairs(3), repeats=3, progress=False)
    assert [r["batch"] for r in records] == [1] and estimator.asked == [[2]] * 5
