"""``single`` and ``mid`` with perfect, symmetric and random votes instead of a trained net."""

import copy

import numpy as np
import pytest
import torch
from helpers.votes import PerfectVotes, check_sound, error, view
from two_view_pose.core.geometry import View, invert, make_transform
from two_view_pose.pose_estimator.fusion.estimator import Sighting
from two_view_pose.pose_estimator.fusion.mid import MidFusionEstimator
from two_view_pose.pose_estimator.fusion.one_view import solve_one_view
from two_view_pose.pose_estimator.fusion.single import SingleViewEstimator
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.types import PoseEstimate


@pytest.fixture(scope="module")
def trusting(networks: PoseNetworks) -> PoseNetworks:
    """Networks whose volumes reproduce the votes."""
    networks = copy.deepcopy(networks)
    for volume in (networks.volume.coarse, networks.volume.fine):
        torch.nn.init.zeros_(volume.output.weight)
    return networks


def estimate(networks, frontend, views, name="brick", method=MidFusionEstimator) -> PoseEstimate:
    estimator = method(networks)
    estimator.frontend = frontend
    return estimator.estimate(views, name)


def test_inconsistent_symmetric_votes_give_a_wrong_pose(trusting):
    # The brick has no symmetry: the same confusion of the second view cannot be resolved.
    networks = copy.deepcopy(trusting)
    model = copy.deepcopy(networks.objects["crate"])
    turn = model.symmetries[1]
    object.__setattr__(model, "symmetries", np.eye(4)[None])
    networks.objects["crate"] = model
    frontend = PerfectVotes(trusting, (0, 1))
    assert np.allclose(trusting.objects["crate"].symmetries[1], turn)
    found = estimate(networks, frontend, [view(20), view(65)], "crate")
    check_sound(found, 2)
    assert error(found, networks, "crate", 20) > 0.1


def test_a_second_view_lowers_the_error_of_noisy_votes(trusting):
    alone, fused = (
        estimate(trusting, PerfectVotes(trusting, noise=0.8), [view(20), *more])
        for more in ([], [view(80)])
    )
    assert error(fused, trusting, "brick", 20) < error(alone, trusting, "brick", 20)


def test_the_world_frame_does_not_matter(trusting):
    moved = make_transform(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]), np.array([1.0, 2, 3]))
    pair = [view(20), view(65)]
    elsewhere = [View(v.image, v.K, v.T_cam_world @ invert(moved)) for v in pair]
    estimator = MidFusionEstimator(trusting)
    frontend = PerfectVotes(trusting)
    encoded = [frontend.encode_view(v, 0) for v in pair]
    model = trusting.objects["brick"]
    first = solve_one_view(encoded[0], model, 1.4)
    [here] = estimator.fuse([Sighting(encoded, 0, model, first)])
    for e, v in zip(encoded, elsewhere, strict=True):
        object.__setattr__(e, "view", v)
    [there] = estimator.fuse([Sighting(encoded, 0, model, first)])
    assert np.allclose(here.T_cam_obj, there.T_cam_obj, atol=1e-4)


@pytest.mark.parametrize("method", [SingleViewEstimator, MidFusionEstimator])
def test_unknown_objects_and_no_views_are_refused(networks, method):
    with pytest.raises(ValueError, match="do not know the object 'teapot'; they know brick, crate"):
        method(networks).estimate([view(0)], "teapot")
    with pytest.raises(ValueError, match="at least one view"):
        method(networks).estimate([], "brick")
