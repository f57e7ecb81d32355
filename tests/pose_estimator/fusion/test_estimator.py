"""What the methods share: detection, second pass, symmetry, refinement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.votes import T_WORLD_OBJ, PerfectVotes, camera, view
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import (
    LINEMOD_K,
    View,
    make_transform,
    project,
    rotation_matrix_2d,
    transform,
)
from two_view_pose.pose_estimator.fusion.estimator import KeypointEstimator
from two_view_pose.pose_estimator.fusion.joint_pnp import (
    consistent_views,
    fit_joint_pose,
    refined_by_votes,
)
from two_view_pose.pose_estimator.fusion.late import LateFusionEstimator
from two_view_pose.pose_estimator.fusion.lru_cache import LruCache
from two_view_pose.pose_estimator.fusion.mid import MidFusionEstimator
from two_view_pose.pose_estimator.fusion.one_view import solve_one_view
from two_view_pose.pose_estimator.fusion.pnp import JointPnpEstimator
from two_view_pose.pose_estimator.fusion.single import SingleViewEstimator
from two_view_pose.pose_estimator.types import PoseEstimate, Roi, roi_of_pose, upright_roll

FUSIONS = [LateFusionEstimator, MidFusionEstimator, JointPnpEstimator]


def looking(networks, method, views, rois=None) -> tuple[PoseEstimate, list]:
    """An estimate, and the regions that its frontend was given."""
    estimator = method(networks)
    estimator.frontend = PerfectVotes(networks)
    return estimator.estimate(views, "brick", rois), estimator.frontend.rois


def true_roi(networks, degrees: float) -> Roi:
    model = networks.objects["brick"]
    return roi_of_pose(camera(degrees) @ T_WORLD_OBJ, LINEMOD_K, model.diameter, 1.4)


@pytest.mark.parametrize("method", FUSIONS)
def test_two_passes_over_every_view(networks, method):
    found, rois_seen = looking(networks, method, [view(20), view(70)])
    nothing, again = rois_seen[:2], rois_seen[2:]
    assert nothing == [None, None]
    assert len(again) == 2
    # The second pass crops at the pose from all votes.
    for roi, degrees in zip(again, (20, 70), strict=True):
        assert np.abs(roi.center - true_roi(networks, degrees).center).max() < 30
    # The answer says where the object was found at first.
    assert np.abs(found.rois[0].center - again[0].center).max() > 0.5


def test_methods_may_share_what_they_encode(networks):
    """Same answers, and each pair of views is encoded once."""
    requests = [([view(20), view(70)], "brick"), ([view(30), view(60)], "crate")]
    frontend, encodings = PerfectVotes(networks), LruCache(4)
    for method in FUSIONS:
        alone, sharing = method(networks), method(networks)
        alone.frontend, sharing.frontend, sharing.encodings = (
            PerfectVotes(networks), frontend, encodings
        )  # fmt: skip
        expected, found = alone.estimate_batch(requests), sharing.estimate_batch(requests)
        for a, b in zip(expected, found, strict=True):
            assert np.array_equal(a.T_cam_obj, b.T_cam_obj)
        assert frontend.calls == alone.frontend.calls
    with_region = sharing.estimate(*requests[0], [true_roi(networks, d) for d in (20, 70)])
    assert frontend.calls > alone.frontend.calls and with_region.rois is not None


@pytest.mark.parametrize("method", [SingleViewEstimator, *FUSIONS])
def test_one_view_has_two_passes_and_is_solved_alone(networks, method):
    found, rois_seen = looking(networks, method, [view(20)])
    assert rois_seen[0] is None and len(rois_seen) == 2
    assert np.array_equal(
        found.T_cam_obj, looking(networks, SingleViewEstimator, [view(20)])[0].T_cam_obj
    )


@pytest.mark.parametrize("method", [SingleViewEstimator, *FUSIONS])
def test_given_regions_replace_the_detector(networks, method):
    rois = [true_roi(networks, 20), true_roi(networks, 70)]
    found, rois_seen = looking(networks, method, [view(20), view(70)], rois)
    seen = 1 if method is SingleViewEstimator else 2
    assert rois_seen[:seen] == rois[:seen]
    assert found.rois == rois[:seen]
    with pytest.raises(ValueError, match="one region for each of the 2 views, got 1"):
        looking(networks, method, [view(20), view(70)], rois[:1])


def test_a_region_of_a_pose_holds_the_object(networks):
    model = networks.objects["brick"]
    T = camera(30) @ T_WORLD_OBJ
    roi = true_roi(networks, 30)
    pixels = project(transform(T, model.vertices), LINEMOD_K)
    assert np.abs(pixels - roi.center).max() < roi.side / 2
    ends = T[:3, 3] + np.array([[-0.5, 0, 0], [0.5, 0, 0]]) * model.diameter
    assert roi.side == pytest.approx(1.4 * np.ptp(project(ends, LINEMOD_K)[:, 0]))
    behind = roi_of_pose(np.diag([1.0, 1, -1, 1]) @ T, LINEMOD_K, model.diameter, 1.4)
    assert np.isfinite([*behind.center, behind.side]).all() and behind.side > 0


def test_views_are_detected_jointly(networks):
    """What the frontend finds in all views at once is what each is then encoded at."""

    class Together(PerfectVotes):
        def regions(self, requests):
            return [[None, true_roi(networks, 70)]]

    estimator = LateFusionEstimator(networks)
    estimator.frontend = Together(networks)
    found = estimator.estimate([view(20), view(70)], "brick")
    assert estimator.frontend.rois[0] is None
    np.testing.assert_array_equal(found.rois[1].center, true_roi(networks, 70).center)


def test_symmetric_votes_are_permuted_to_the_reference(networks):
    model = networks.objects["crate"]
    frontend = PerfectVotes(networks, (0, 1, 1))
    encoded = [frontend.encode_view(view(degrees), 1) for degrees in (20, 65, -10)]
    agreed, points = consistent_views(encoded, model)
    truth = transform(camera(20) @ T_WORLD_OBJ, model.keypoints)
    np.testing.assert_allclose(points, truth, atol=1e-4)
    for seen, degrees in zip(agreed, (20, 65, -10), strict=True):
        expected = project(transform(camera(degrees) @ T_WORLD_OBJ, model.keypoints), seen.K_grid)
        np.testing.assert_allclose(seen.vote_mean, expected, atol=1e-6)
    # What was given is as it was.
    assert not np.allclose(encoded[1].vote_mean, agreed[1].vote_mean, atol=0.5)


@pytest.mark.parametrize("degrees", [21.0, 65.0])
def test_the_joint_pose_is_the_truth_whatever_the_baseline(networks, degrees):
    model = networks.objects["brick"]
    first, _ = looking(networks, SingleViewEstimator, [view(20)])
    frontend = PerfectVotes(networks)
    encoded = [frontend.encode_view(view(d), 0) for d in (20, degrees)]
    truth = transform(camera(20) @ T_WORLD_OBJ, model.keypoints)
    wrong = truth + np.array([0, 0, 0.3])  # as a triangulation with hardly any baseline may be
    joint = fit_joint_pose(encoded, wrong, model, first)
    np.testing.assert_allclose(joint.keypoints, truth, atol=2e-3)
    assert (np.linalg.eigvalsh(joint.keypoint_covariance) > 0).all()


def test_contradictory_votes_keep_the_previous_pose(networks):
    model = networks.objects["brick"]
    first, _ = looking(networks, SingleViewEstimator, [view(20)])
    away = make_transform(np.diag([-1.0, 1, -1]), [0, 0, -5.0])  # behind the second camera
    frontend = PerfectVotes(networks)
    encoded = [frontend.encode_view(view(20), 0), frontend.encode_view(view(70), 0)]
    lost = replace(encoded[1], view=View(encoded[1].view.image, LINEMOD_K, away))
    far = np.full((9, 3), 50.0)
    assert fit_joint_pose([encoded[0], lost], far, model, first) is first


def test_a_joint_pose_of_inconsistent_depth_is_rejected(networks):
    """Two views that show different things meet somewhere far away."""
    model = networks.objects["brick"]
    first, _ = looking(networks, SingleViewEstimator, [view(20)])
    frontend = PerfectVotes(networks)
    encoded = [frontend.encode_view(view(d), 0) for d in (20, 23)]
    # The second view votes for something where the rays meet at twice the depth.
    T = camera(20) @ T_WORLD_OBJ
    T[2, 3] *= 2
    T[:2, 3] *= 2
    elsewhere = camera(23) @ np.linalg.inv(camera(20)) @ T
    votes = project(transform(elsewhere, model.keypoints), encoded[1].K_grid)
    encoded[1] = replace(encoded[1], vote_mean=votes)
    joint = fit_joint_pose(encoded, transform(T, model.keypoints), model, first)
    depth = float(joint.T_cam_obj[2, 3] / first.T_cam_obj[2, 3])
    assert 1 / 1.5 < depth < 1.5


def test_collapsed_votes_leave_the_object_at_the_depth_of_its_region(networks):
    """All votes in one point fit an object that is far away."""
    model = networks.objects["brick"]
    frontend = PerfectVotes(networks)
    encoded = frontend.encode_view(view(20), 0)
    assert solve_one_view(encoded, model, 1.4).T_cam_obj[2, 3] == pytest.approx(0.9, abs=0.1)
    middle = encoded.vote_mean[-1] + 0.02 * (encoded.vote_mean - encoded.vote_mean[-1])
    found = solve_one_view(replace(encoded, vote_mean=middle), model, 1.4)
    region = found.rois[0]
    placed = roi_of_pose(found.T_cam_obj, LINEMOD_K, model.diameter, 1.4)
    assert placed.side == pytest.approx(region.side, rel=0.01)
    assert np.abs(placed.center - region.center).max() < 1
    assert np.isfinite(found.keypoint_covariance).all()
    # Its covariance is large.
    assert found.keypoint_covariance[0, 2, 2] > (0.3 * model.diameter) ** 2


def test_a_refinement_weighs_keypoints_and_votes_by_their_covariances(networks):
    """The keypoints lie 2 cm deeper than the votes say."""
    model = networks.objects["brick"]
    first, _ = looking(networks, SingleViewEstimator, [view(20)])
    frontend = PerfectVotes(networks)
    encoded = [frontend.encode_view(view(d), 0) for d in (20, 65)]
    truth = transform(camera(20) @ T_WORLD_OBJ, model.keypoints)
    deeper = truth + np.array([0, 0, 0.02])
    depths = {}
    for deviation, use in ((1.0, True), (0.0, True), (0.0, False)):
        covariance = np.tile(np.eye(3) * deviation**2, (9, 1, 1))
        pose = replace(first, keypoints=deeper, keypoint_covariance=covariance)
        found = refined_by_votes(pose, encoded, model, first, first, with_keypoints=use)
        depths[deviation, use] = found.keypoints[-1, 2] - truth[-1, 2]
    assert depths[1.0, True] == pytest.approx(0.0, abs=1e-4)
    assert 1e-4 < depths[0.0, True] < 0.02
    assert depths[0.0, False] == pytest.approx(0.0, abs=1e-6)


def test_a_refinement_of_inconsistent_depth_falls_back_on_the_votes(networks):
    model = networks.objects["brick"]
    first, _ = looking(networks, SingleViewEstimator, [view(20)])
    near = replace(first, T_cam_obj=make_transform(np.eye(3), np.array([0, 0, 0.3])))
    frontend = PerfectVotes(networks)
    encoded = [frontend.encode_view(view(d), 0) for d in (20, 65)]
    found = refined_by_votes(first, encoded, model, near, near, with_keypoints=False)
    assert np.array_equal(found.T_cam_obj, near.T_cam_obj)


@pytest.mark.parametrize("method", [MidFusionEstimator, LateFusionEstimator])
def test_refine_makes_the_pose_that_of_the_votes(networks, method):
    plain, refined = method(networks), method(networks, refine="votes")
    truth = transform(camera(20) @ T_WORLD_OBJ, networks.objects["brick"].keypoints)
    errors = []
    for estimator in (plain, refined):
        estimator.frontend = PerfectVotes(networks, noise=0.5)
        found = estimator.estimate([view(20), view(25)], "brick")
        errors.append(np.linalg.norm(found.keypoints - truth, axis=1).mean())
    assert errors[1] < 0.5 * errors[0]


def test_wrong_calls_are_refused(networks):
    with pytest.raises(
        ValueError, match="unknown solver 'best'; there are soft, soft-mean, kabsch, hard"
    ):
        MidFusionEstimator(networks, "best")
    with pytest.raises(TypeError, match="fuse"):
        KeypointEstimator(networks)
    with pytest.raises(ValueError, match="refine must be none or votes, got 'twice'"):
        MidFusionEstimator(networks, refine="twice")


@pytest.mark.parametrize("roll", [-2.5, -0.7, 0.0, 0.3, 1.2])
def test_upright_roll_makes_the_axis_point_up(roll):
    T = rolled(roll) @ camera(35) @ T_WORLD_OBJ
    ends = project(transform(T, np.array([[0, 0, 0], [0, 0, 1e-4]])), LINEMOD_K)
    along = rotation_matrix_2d(upright_roll(T, LINEMOD_K), 128)[:2, :2] @ (ends[1] - ends[0])
    assert along[1] < 0 and abs(along[0]) < 1e-3 * abs(along[1])


def test_an_axis_towards_the_camera_has_no_upright_roll():
    above = make_transform(np.diag([1.0, -1, -1]), np.array([0, 0, 0.8]))
    assert upright_roll(above, LINEMOD_K) is None
    assert upright_roll(make_transform(np.eye(3), np.array([0.0, 0, -0.5])), LINEMOD_K) is None


def rolled(angle: float) -> np.ndarray:
    """The motion (4, 4) of a camera that is rotated about its line of sight."""
    return make_transform(Rotation.from_euler("z", angle).as_matrix(), np.zeros(3))


@pytest.mark.parametrize("roll", [0.0, 0.8, 2.4])
def test_the_second_pass_crops_are_upright(networks, roll):
    asked = []

    class Recording(PerfectVotes):
        def encode_rotated(self, targets, rolls):
            asked.extend(map(tuple, rolls))
            return super().encode_rotated(targets, rolls)

    views = [replace(view(d), T_cam_world=rolled(roll) @ camera(d)) for d in (20, 70)]
    estimator = LateFusionEstimator(networks)
    estimator.frontend = Recording(networks)
    found = estimator.estimate(views, "brick")
    upright = upright_roll(found.T_cam_obj, LINEMOD_K)
    assert asked[0][0] == pytest.approx(np.clip(upright, -1.5, 1.5), abs=0.1)
    assert asked[0][0] == pytest.approx(max(-roll, -1.5), abs=0.1)
    assert min(asked[0]) == asked[0][0] - 0.2 and max(asked[0]) == asked[0][0] + 0.2


def test_without_an_upright_roll_that_of_the_first_pass_is_kept(networks):
    asked = []

    class Recording(PerfectVotes):
        def encode_view(self, view, index, roi=None):
            return replace(super().encode_view(view, index, roi), roll=0.5 * self.calls)

        def encode_rotated(self, targets, rolls):
            asked.extend(own[0] for own in rolls)
            return super().encode_rotated(targets, rolls)

    estimator = LateFusionEstimator(networks)
    estimator.frontend = Recording(networks)
    [sighting] = estimator.encode_views(estimator.targets([([view(20)], "brick")], None), ["brick"])
    above = make_transform(np.diag([1.0, -1, -1]), np.array([0, 0, 0.9]))
    estimator.encode_again([replace(sighting, first=replace(sighting.first, T_cam_obj=above))])
    assert asked == [0.5]
