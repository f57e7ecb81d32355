"""Association of detections across views."""

import numpy as np
import pytest
from helpers.votes import camera, view
from two_view_pose.core.geometry import LINEMOD_K, make_transform
from two_view_pose.pose_estimator.fusion.joint_detection import (
    associate_detections,
    association_costs,
    refine_roi_scales,
)
from two_view_pose.pose_estimator.types import Roi, roi_of_pose

DIAMETER, SCALE = 0.1, 1.4


def cost(first: Roi, second: Roi, *views) -> float:
    """Of the best depth along the ray of one region."""
    return float(association_costs([first], [second], *views, DIAMETER, SCALE)[0].min())


def seen(place, degrees: float, score: float) -> Roi:
    """The region of an object at a place in the world, from a camera on the circle."""
    T = camera(degrees) @ make_transform(np.eye(3), np.asarray(place, float))
    return roi_of_pose(T, LINEMOD_K, DIAMETER, SCALE, score)


def test_the_other_view_decides_between_two_peaks():
    """A distractor scores higher than the object in one view, and not seen in the other."""
    views = [view(20), view(60)]
    here, distractor = (0.02, 0.03, 0.0), (-0.15, 0.1, 0.0)
    first = [seen(distractor, 20, 0.8), seen(here, 20, 0.4)]
    second = [seen(here, 60, 0.9)]
    assert associate_detections([first, second], views, DIAMETER, SCALE) == [1, 0]
    assert associate_detections([second, first], views[::-1], DIAMETER, SCALE) == [0, 1]


def test_the_highest_scores_win_where_nothing_matches():
    views = [view(20), view(60)]
    first = [seen((0.2, 0.0, 0.0), 20, 0.9), seen((0.25, -0.1, 0.0), 20, 0.1)]
    second = [seen((0.0, 0.25, 0.0), 60, 0.8), seen((-0.1, 0.3, 0.0), 60, 0.2)]
    assert associate_detections([first, second], views, DIAMETER, SCALE) == [0, 0]


def test_one_view_alone_keeps_its_best_peak():
    regions = [seen((0, 0, 0), 20, 0.5), seen((0.1, 0, 0), 20, 0.4)]
    assert associate_detections([regions], [view(20)], DIAMETER, SCALE) == [0]


def test_three_views_agree():
    views = [view(d) for d in (20, 60, 100)]
    here, distractor = (0.02, 0.03, 0.0), (-0.15, 0.1, 0.0)
    candidates = [
        [seen(distractor, 20, 0.9), seen(here, 20, 0.3)],
        [seen(here, 60, 0.6), seen(distractor, 60, 0.1)],
        [seen((0.2, -0.1, 0), 100, 0.5), seen(here, 100, 0.4)],
    ]
    assert associate_detections(candidates, views, DIAMETER, SCALE) == [1, 0, 1]


@pytest.mark.parametrize("degrees", [22, 60, 150])
def test_cost_of_one_object_is_small_and_of_two_is_large(degrees):
    views = view(20), view(degrees)
    region = seen((0.05, 0, 0), 20, 1)
    assert cost(region, seen((0.05, 0, 0), degrees, 1), *views) < 0.1
    assert cost(region, seen((-0.1, 0.12, 0), degrees, 1), *views) > 8
    # A region of twice the size means an object at half the distance.
    near = seen((0.05, 0, 0), degrees, 1)
    twice = Roi(near.center, 2 * near.side, 1.0)
    assert cost(region, twice, *views) > 2


def test_a_camera_that_looks_away_fits_nothing():
    behind = view(20)
    flipped = type(behind)(
        behind.image, behind.K, make_transform(np.diag([-1.0, 1, -1]), np.zeros(3)) @ camera(20)
    )
    region = seen((0.0, 0, 0), 20, 1)
    assert cost(region, region, behind, flipped) == 16


def test_sizes_come_from_where_the_rays_meet():
    """Regions of any size with right centers get the sides of the object that is seen there."""
    views = [view(d) for d in (20, 60, 100)]
    here = (0.02, 0.03, 0.0)
    true = [seen(here, d, 0.5) for d in (20, 60, 100)]
    wrong = [
        Roi(r.center, f * r.side, r.score) for r, f in zip(true, (1.25, 1.1, 0.8), strict=True)
    ]
    for number in (2, 3):
        sized = refine_roi_scales(wrong[:number], views[:number], DIAMETER, SCALE)
        for region, given, right in zip(sized, wrong, true, strict=False):
            assert region.side == pytest.approx(right.side, rel=0.05)
            assert region.center is given.center and region.score == given.score
    assert refine_roi_scales(wrong[:1], views[:1], DIAMETER, SCALE) == wrong[:1]


def test_regions_that_do_not_belong_together_keep_their_sizes():
    views = [view(d) for d in (20, 60, 100)]
    regions = [seen((0.2, 0, 0), 20, 0.9), seen((0, 0.25, 0), 60, 0.8)]
    assert refine_roi_scales(regions, views[:2], DIAMETER, SCALE) == regions
    # A third view that fits neither leaves the other two to agree.
    pair = [seen((0.0, 0, 0), 20, 0.9), seen((0.0, 0, 0), 60, 0.8)]
    larger = [Roi(r.center, 1.2 * r.side, r.score) for r in pair]
    odd = Roi(np.array([20.0, 400.0]), 60.0, 0.9)
    *sized, kept = refine_roi_scales([*larger, odd], views, DIAMETER, SCALE)
    assert kept is odd
    assert [r.side for r in sized] == pytest.approx([r.side for r in pair], rel=0.05)
