"""Estimators that answer batches and those that do not."""

import numpy as np
from two_view_pose.pose_estimator.fusion.batching import batch_size, estimate_all
from two_view_pose.pose_estimator.types import PoseEstimate, Roi

REQUESTS = [(("a",), "cat"), (("b", "c"), "duck")]
ROIS = [[Roi(np.zeros(2), 1.0, 1.0)], [Roi(np.zeros(2), 2.0, 1.0)] * 2]


class OneByOne:
    def estimate(self, views, object_name, *rois) -> PoseEstimate:
        return views, object_name, *rois  # type: ignore[return-value]


class Together(OneByOne):
    def estimate_batch(self, requests, *rois) -> list[PoseEstimate]:
        return ["together", requests, *rois]  # type: ignore[list-item]


def test_who_answers_no_batches_is_asked_one_by_one():
    assert estimate_all(OneByOne(), REQUESTS) == REQUESTS
    told = estimate_all(OneByOne(), REQUESTS, ROIS)
    assert told == [(*request, rois) for request, rois in zip(REQUESTS, ROIS, strict=True)]
    assert batch_size(OneByOne()) == 1


def test_who_answers_batches_is_asked_once():
    assert estimate_all(Together(), REQUESTS) == ["together", REQUESTS]
    assert estimate_all(Together(), REQUESTS, ROIS) == ["together", REQUESTS, ROIS]
    assert batch_size(Together()) == 8
    told = Together()
    told.batch_size = 5  # type: ignore[attr-defined]
    assert batch_size(told) == 5
