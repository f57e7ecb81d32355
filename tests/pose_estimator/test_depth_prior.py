"""A guess of the depth in PnP: its derivative, what it settles and what it leaves to the votes."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.depth_prior import DepthPrior, WithDepths
from two_view_pose.pose_estimator.geometry import LINEMOD_K, make_transform, project, transform
from two_view_pose.pose_estimator.multi_view_pnp import multi_view_pnp
from two_view_pose.pose_estimator.pnp import uncertainty_pnp

RNG = np.random.default_rng(0)
MODEL = np.vstack([RNG.uniform(-0.07, 0.07, (8, 3)), np.zeros(3)])
T_TRUE = make_transform(Rotation.from_euler("xyz", [1.9, 0.3, -0.4]).as_matrix(), [0.05, -0.1, 0.9])
PIXELS = project(transform(T_TRUE, MODEL), LINEMOD_K)


class Flat:
    """Votes that say nothing."""

    def cost(self, rotation, translation):
        return 1.0 if translation[2] > 0 else np.inf

    def normal_equations(self, rotation, translation):
        return np.zeros(6), np.zeros((6, 6))


def two_cameras() -> np.ndarray:
    second = make_transform(Rotation.from_euler("y", 0.4).as_matrix(), [-0.3, 0.02, 0.1])
    return np.stack([np.eye(4), second])


def test_the_gradient_is_that_of_the_cost():
    priors = [DepthPrior(0.8, 0.05), DepthPrior(1.0, 0.1)]
    problem = WithDepths(Flat(), priors, two_cameras())
    gradient, information = problem.normal_equations(np.eye(3), T_TRUE[:3, 3])
    numeric = approx_fprime(T_TRUE[:3, 3], lambda t: problem.cost(np.eye(3), t), 1e-7)
    np.testing.assert_allclose(gradient[3:], numeric, rtol=1e-4)
    assert not gradient[:3].any()
    assert np.linalg.matrix_rank(information) == 2
    assert problem.cost(np.eye(3), np.array([0, 0, -1.0])) == np.inf


def test_two_views_that_guess_alike_count_as_one():
    one = WithDepths(Flat(), [DepthPrior(0.8, 0.05)], np.eye(4)[None])
    two = WithDepths(Flat(), [DepthPrior(0.8, 0.05)] * 2, np.stack([np.eye(4)] * 2))
    t = np.array([0, 0, 0.9])
    assert one.cost(np.eye(3), t) == pytest.approx(two.cost(np.eye(3), t))


def test_sharp_votes_overrule_the_guess_and_vague_ones_follow_it():
    depths = []
    for deviation in (0.05, 20.0):
        covariances = np.tile(np.eye(2) * deviation**2, (9, 1, 1))
        prior = DepthPrior(1.2, 0.05)
        depths.append(uncertainty_pnp(MODEL, PIXELS, covariances, LINEMOD_K, prior).T_cam_obj[2, 3])
    assert depths[0] == pytest.approx(0.9, abs=2e-3)
    assert depths[1] == pytest.approx(1.2, abs=0.06)


def test_the_guess_holds_what_wrong_votes_would_carry_away():
    """Votes that shrink towards their middle mean an object far away."""
    middle = PIXELS.mean(0)
    shrunk = middle + 0.6 * (PIXELS - middle)
    covariances = np.tile(np.eye(2) * 8.0**2, (9, 1, 1))
    alone = uncertainty_pnp(MODEL, shrunk, covariances, LINEMOD_K).T_cam_obj[2, 3]
    told = uncertainty_pnp(MODEL, shrunk, covariances, LINEMOD_K, DepthPrior(0.9, 0.05))
    assert alone > 1.3
    assert told.T_cam_obj[2, 3] == pytest.approx(0.9, abs=0.12)
    assert told.covariance[5, 5] < 0.06**2


def test_the_second_views_guess_is_along_its_own_axis():
    cameras = two_cameras()
    means = [project(transform(T @ T_TRUE, MODEL), LINEMOD_K) for T in cameras]
    true_depths = [(T @ T_TRUE)[2, 3] for T in cameras]
    given = dict(
        model_points=MODEL, pixels=np.stack(means),
        covariances=np.tile(np.eye(2) * 3.0**2, (2, 9, 1, 1)),
        Ks=[LINEMOD_K] * 2, T_cam_world=list(cameras), starts=[T_TRUE],
    )  # fmt: skip
    right = multi_view_pnp(**given, depths=[DepthPrior(d, 0.02) for d in true_depths])
    np.testing.assert_allclose(right.T_cam_obj, T_TRUE, atol=1e-5)
    assert right.cost == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(ValueError, match="depths must be one for each of 2 views, got 1"):
        multi_view_pnp(**given, depths=[DepthPrior(0.9, 0.02)])
