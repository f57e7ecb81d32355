"""Implausible photographs, cameras and motions are named; plausible ones are not."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.assets import load_object
from two_view_pose.core.errors import InputError
from two_view_pose.core.geometry import LINEMOD_K, View, invert, make_transform
from two_view_pose.pose_estimator.fusion.view_checks import (
    AGREEMENT,
    check_cameras,
    check_motion,
    check_photographs,
    check_scores,
    confidence,
)
from two_view_pose.pose_estimator.types import PoseEstimate, roi_of_pose

NAMES = ["a.png", "b.png"]
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def photograph(seed: int = 0, size: tuple[int, int] = (480, 640)) -> np.ndarray:
    coarse = np.random.default_rng(seed).integers(0, 255, (12, 16, 3), np.uint8)
    return cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)


def two_views(T: np.ndarray) -> list[View]:
    return [View(photograph(0), LINEMOD_K, np.eye(4)), View(photograph(1), LINEMOD_K, T)]


def orbit(degrees: float, distance: float = 0.9) -> np.ndarray:
    """The motion of a camera around a point in front of it."""
    R = Rotation.from_euler("yx", [degrees, degrees / 4], degrees=True).as_matrix()
    center = np.array([0.0, 0.0, distance])
    return make_transform(R, center - R @ center)


def seen(name: str, T_cam_obj: np.ndarray) -> PoseEstimate:
    """The estimate from one view that is right but for an error of eight percent in depth."""
    model = load_object(name)
    off = T_cam_obj.copy()
    off[:3, 3] *= 1.08
    return PoseEstimate(
        T_cam_obj=off,
        keypoints=model.keypoints,
        keypoint_covariance=np.tile(np.eye(3), (9, 1, 1)),
        rois=[roi_of_pose(T_cam_obj, LINEMOD_K, model.diameter, 1.4, score=0.9)],
    )


def times(factor: float):
    def scale(T):
        return make_transform(T[:3, :3], factor * T[:3, 3])

    return scale


POSE = make_transform(
    Rotation.from_euler("xyz", [110, 20, 40], degrees=True).as_matrix(), [0.04, -0.03, 0.9]
)


def compare(T_given: np.ndarray, T_true: np.ndarray, name: str = "can"):
    alone = seen(name, POSE), seen(name, T_true @ POSE)
    return check_motion(*alone, two_views(T_given), load_object(name))


@pytest.mark.parametrize("name", ["can", "eggbox", "glue"])
@pytest.mark.parametrize("degrees", [-60, -15, 10, 30, 75])
def test_right_motions_raise_no_doubt(name, degrees):
    error, doubts = compare(orbit(degrees), orbit(degrees), name)
    assert error < AGREEMENT and doubts == []


def test_views_of_a_symmetric_object_agree_in_any_of_its_poses():
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])  # eggbox: 180 degrees about z
    alone = seen("eggbox", POSE), seen("eggbox", orbit(30) @ POSE @ turned)
    assert check_motion(*alone, two_views(orbit(30)), load_object("eggbox"))[1] == []


@pytest.mark.parametrize("degrees", [-50, 30])
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (invert, "inverted, or the photographs are swapped"),
        (lambda T: OPENGL @ T @ OPENGL, "OpenGL"),
        (lambda T: OPENGL @ invert(T) @ OPENGL, "inverted, and between OpenGL"),
        (times(1e-3), "divided by 1000 twice"),
        (times(1e3), "millimeters"),
        (times(1e2), "centimeters"),
        (times(1 / 0.0254), "inches"),
        (lambda T: times(1e3)(invert(T)), "inverted, and in millimeters"),
    ],
)
def test_wrong_motions_are_explained(wrong, words, degrees):
    T = orbit(degrees)
    try:
        _, doubts = compare(wrong(T), T)
    except InputError as error:
        doubts = [str(error)]
    assert len(doubts) == 1 and words in doubts[0]


def test_a_motion_that_nothing_explains():
    error, doubts = compare(orbit(30), orbit(30) @ orbit(70) @ orbit(-30, 2.0))
    assert error > AGREEMENT and "disagree" in doubts[0] and "probably" not in doubts[0]


def scaled_view(factor: float) -> list[View]:
    return [View(photograph(0, (int(480 * factor), int(640 * factor))), LINEMOD_K, np.eye(4))]


@pytest.mark.parametrize(
    ("factor", "words"), [(2, "images 0.5 times"), (4 / 3, "0.75 times"), (1.5, "0.67 times")]
)
def test_the_matrix_of_smaller_photographs_is_named(factor, words):
    (doubt,) = check_cameras(scaled_view(factor))
    assert words in doubt
    assert check_cameras(scaled_view(1)) == []


def test_impossible_matrices_are_refused():
    with pytest.raises(InputError, match=r"principal point is outside .* images 2 times as large"):
        check_cameras(scaled_view(0.5))
    K = np.diag([1 / 500, 1 / 500, 1.0]) @ LINEMOD_K
    K[:2, 2] = LINEMOD_K[:2, 2]
    with pytest.raises(InputError, match="focal lengths are too short"):
        check_cameras([View(photograph(), K, np.eye(4))])


def gray(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (gray, "is gray"),
        (lambda image: image // 16, "nearly black"),
        (lambda image: np.full_like(image, 200), "one even color"),
    ],
)
def test_photographs_that_show_little(change, words):
    image, other = photograph(0), photograph(1)
    views = [View(change(image), LINEMOD_K, np.eye(4)), View(other, LINEMOD_K, orbit(20))]
    (doubt,) = check_photographs(views, NAMES)
    assert doubt.startswith("a.png") and words in doubt
    assert check_photographs(two_views(orbit(20)), NAMES) == []


def test_the_same_photograph_twice():
    image = photograph()
    _, code = cv2.imencode(".jpg", image)
    again = cv2.imdecode(code, cv2.IMREAD_COLOR)
    views = [View(image, LINEMOD_K, np.eye(4)), View(image, LINEMOD_K, orbit(20))]
    with pytest.raises(InputError, match=r"a\.png and b\.png are the same photograph"):
        check_photographs(views, NAMES)
    views[1] = View(again, LINEMOD_K, orbit(20))
    (doubt,) = check_photographs(views, NAMES)
    assert "nearly the same picture" in doubt
    (doubt,) = check_photographs(two_views(np.eye(4)), NAMES)
    assert "identity" in doubt


def test_scores_and_confidence():
    sure = seen("can", POSE)
    lost = seen("can", POSE)
    lost.rois[0] = roi_of_pose(POSE, LINEMOD_K, 0.2, 1.4, score=0.05)
    assert check_scores(sure, NAMES, "can") == []
    (doubt,) = check_scores(lost, NAMES, "can")
    assert "can is hardly seen in a.png" in doubt and "0.05" in doubt
    assert confidence(sure) == pytest.approx(0.9) and confidence(lost) == pytest.approx(0.05)
    assert confidence(sure, 0.02) > 0.85 and confidence(sure, 2 * AGREEMENT) < 0.05
