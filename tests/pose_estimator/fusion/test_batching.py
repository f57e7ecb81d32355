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


def test_estimators_without_estimate_batch_get_one_request_at_a_time():
    assert estimate_all(OneByOne(), REQUESTS) == REQUESTS
    found = estimate_all(OneByOne(), REQUESTS, ROIS)
    assert found == [(*request, rois) for request, rois in zip(REQUESTS, ROIS, strict=True)]
    assert batch_size(OneByOne()) == 1


def test_estimators_with_estimate_batch_are_called_once():
    assert estimate_all(Together(), REQUESTS) == ["together", REQUESTS]
    assert estimate_all(Together(), REQUESTS, ROIS) == ["together", REQUESTS, ROIS]
    assert batch_size(Together()) == 8
    found = Together()
    found.batch_size = 5  # type: ignore[attr-defined]
    assert batch_size(found) == 5
