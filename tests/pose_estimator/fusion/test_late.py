"""``late`` with perfect, symmetric and random votes."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.votes import T_WORLD_OBJ, PerfectVotes, camera, check_sound, error, view
from two_view_pose.core.geometry import LINEMOD_K, View, transform
from two_view_pose.pose_estimator.fusion.estimator import Sighting
from two_view_pose.pose_estimator.fusion.late import LateFusionEstimator
from two_view_pose.pose_estimator.fusion.one_view import solve_one_view
from two_view_pose.pose_estimator.types import PoseEstimate


def estimate(networks, frontend, views, name="brick", solver="soft") -> PoseEstimate:
    estimator = LateFusionEstimator(networks, solver)
    estimator.frontend = frontend
    return estimator.estimate(views, name)


@pytest.mark.parametrize("solver", ["soft", "kabsch", "hard"])
@pytest.mark.parametrize("more", [(65,), (21,), (60, -20)])
def test_perfect_votes_give_the_pose(networks, solver, more):
    views = [view(20), *map(view, more)]
    found = estimate(networks, PerfectVotes(networks), views, solver=solver)
    check_sound(found, len(views))
    assert error(found, networks, "brick", 20) < 1e-4
    truth = transform(camera(20) @ T_WORLD_OBJ, networks.objects["brick"].keypoints)
    np.testing.assert_allclose(found.keypoints, truth, atol=1e-5)


def test_the_covariance_of_keypoints_is_calibrated(networks):
    truth = transform(camera(20) @ T_WORLD_OBJ, networks.objects["brick"].keypoints)
    votes, estimator = PerfectVotes(networks, noise=0.4), LateFusionEstimator(networks)
    scaled = []
    for _ in range(20):
        encoded = [votes.encode_view(view(degrees), 0) for degrees in (20, 50)]
        model = networks.objects["brick"]
        first = solve_one_view(encoded[0], model, 1.4)
        [found] = estimator.fuse([Sighting(encoded, 0, model, first)])
        off = found.keypoints - truth
        scaled.append(np.einsum("ki,kij,kj->k", off, np.linalg.inv(found.keypoint_covariance), off))
    # The squares of three standard normal numbers.
    assert 2.4 < np.mean(scaled) < 3.6


def test_the_relative_pose_is_used(networks):
    frontend = PerfectVotes(networks)
    pair = [view(20), view(65)]
    encoded = [frontend.encode_view(v, 0) for v in pair]
    wrong = View(pair[1].image, LINEMOD_K, camera(60))
    object.__setattr__(encoded[1], "view", wrong)
    estimator = LateFusionEstimator(networks)
    model = networks.objects["brick"]
    first = solve_one_view(encoded[0], model, 1.4)
    [found] = estimator.fuse([Sighting(encoded, 0, model, first)])
    assert error(found, networks, "brick", 20) > 0.02
