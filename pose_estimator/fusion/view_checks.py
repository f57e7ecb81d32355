"""Whether photographs, cameras and their motion are plausible, and two views agree.

A wrong camera matrix or relative pose still gives a pose, often a meter off. Single views know
neither: they are compared with what the relative pose predicts.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import cv2
import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import View, invert, project, transform
from ..camera_mistakes import OPENGL, find_camera_mistake, scaled
from ..solvers.multi_view_pnp import multi_view_pnp
from ..symmetry import keypoint_permutations
from ..types import PoseEstimate

AGREEMENT = 0.16
"""Largest reprojection error, in sides of the region of interest, of views that agree. None of 26
right poses in generated scenes is above it; with their relative poses inverted, in millimeters or
centimeters, or with OpenGL's axes, all are."""

LOW_SCORE = 0.2
"""In 11 of 12 generated pairs both scores of an object that is not there are below it, and in none
of 26 right poses."""

_EXPLAINED = 0.13
"""Largest reprojection error of a reading that explains a disagreement."""

_IMPOSSIBLE = 3.0
"""Largest baseline, relative to the sum of the object's distances from both cameras."""

_BETTER = 0.5
"""Largest error of a reading that explains a disagreement, relative to that as given."""

_NOISE = 0.06
"""Reprojection error that is not explained, since errors of the votes are as large."""

_VOTE_STD = 0.02
"""Standard deviation of a view's keypoints, in sides of the region."""

_DARK, _GRAY, _SAME = 40, 1.0, 1.0  # gray levels
_MOVED_METERS, _MOVED_RADIANS = 0.02, 0.04
_STILL = 1e-4  # meters and radians

_READINGS: tuple[tuple[str, str, Callable[[np.ndarray], np.ndarray]], ...] = (
    ("it is inverted, or the photographs are swapped", "invert it", invert),
    ("it is in millimeters", "divide its translation by 1000", scaled(1e-3)),
    ("it is in centimeters", "divide its translation by 100", scaled(1e-2)),
    ("it is in inches", "multiply its translation by 0.0254", scaled(0.0254)),
    ("it was divided by 1000 twice", "multiply its translation by 1000", scaled(1e3)),
    (
        "it is between OpenGL's or Blender's cameras (y up, z backward)",
        "multiply it by diag(1, -1, -1, 1) from both sides", lambda T: OPENGL @ T @ OPENGL,
    ),
    (
        "it is inverted, and between OpenGL's or Blender's cameras (y up, z backward)",
        "invert it, then multiply it by diag(1, -1, -1, 1) from both sides",
        lambda T: OPENGL @ invert(T) @ OPENGL,
    ),
    (
        "it is inverted, and in millimeters", "invert it, and divide its translation by 1000",
        lambda T: invert(scaled(1e-3)(T)),
    ),
)  # fmt: skip


def check_cameras(views: Sequence[View]) -> list[str]:
    """Returns what is implausible about the camera matrix.

    Raises:
        InputError: if no camera that took these photographs has such a matrix.
    """
    K, shape = views[0].K, views[0].image.shape
    mistake = find_camera_mistake(K, (shape[0], shape[1]))
    if mistake is None:
        return []
    cause = f"; probably {mistake.cause}" if mistake.cause else ""
    text = f"K: {mistake.problem} ({mistake.detail}){cause}: {mistake.remedy}"
    if mistake.severity == "error":
        raise InputError(text)
    return [text]


def check_photographs(views: Sequence[View], names: Sequence[str]) -> list[str]:
    """Returns what is implausible about the photographs, which ``names`` call in messages.

    Raises:
        InputError: if two of them are the same.
    """
    found = []
    small = [cv2.resize(v.image, (64, 64), interpolation=cv2.INTER_AREA) for v in views]
    for view, name, image in zip(views, names, small, strict=True):
        pixels = view.image[::4, ::4]
        if (brightest := int(view.image.max())) < _DARK:
            found.append(
                f"{name} is nearly black: its brightest pixel is {brightest} of 255; if it holds "
                "10 to 14 bits in 16, multiply it up to 16 bits"
            )
        elif np.ptp(image.reshape(-1, 3).astype(int), axis=0).max() < 2:
            found.append(f"{name} shows one even color")
        elif np.ptp(pixels.astype(np.int16), axis=2).mean() < _GRAY:
            found.append(
                f"{name} is gray, and the networks have learnt from color: expect wrong poses; "
                "give the color photograph"
            )
    for (view, other), (name, second), (a, b) in zip(
        pairwise(views), pairwise(names), pairwise(small), strict=True
    ):
        if np.array_equal(view.image, other.image):
            raise InputError(f"{name} and {second} are the same photograph: give two views")
        T = other.T_cam_world @ invert(view.T_cam_world)
        angle = np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))
        moved = np.linalg.norm(T[:3, 3])
        if max(moved, angle) < _STILL:
            found.append(
                "relative_pose is the identity: the second view adds nothing if the camera did not "
                "move, and else it is a placeholder"
            )
        elif np.abs(a.astype(int) - b).mean() < _SAME and (
            moved > _MOVED_METERS or angle > _MOVED_RADIANS
        ):
            found.append(
                f"{name} and {second} show nearly the same picture, but the camera moved by "
                f"{moved:.3g} m and {np.degrees(angle):.0f} degrees by relative_pose"
            )
    return found


def check_scores(answer: PoseEstimate, names: Sequence[str], object_name: str) -> list[str]:
    """Returns in which photographs the object was hardly detected."""
    return [
        f"{object_name} is hardly seen in {name} (detection score {roi.score:.2f}): it is not "
        "there, hidden, or looks unlike the training images"
        for roi, name in zip(answer.rois, names, strict=False)
        if roi.score < LOW_SCORE
    ]


def check_motion(
    first: PoseEstimate, second: PoseEstimate, views: Sequence[View], model: ObjectModel
) -> tuple[float, list[str]]:
    """Compares what two views see alone with what their relative pose predicts.

    Args:
        first: the pose from the first view alone, in its camera.
        second: from the second view alone, in its camera.
        views: both views.
        model: the object.

    Returns:
        The reprojection error in sides of the region of interest (see `AGREEMENT`), and what is
        implausible.

    Raises:
        InputError: if the cameras are too far apart to see one object.
    """
    T = views[1].T_cam_world @ invert(views[0].T_cam_world)
    error = _reprojection_error(T, first, second, views, model)
    baseline = float(np.linalg.norm(T[:3, 3]))
    distance = sum(float(np.linalg.norm(p.T_cam_obj[:3, 3])) for p in (first, second))
    explained = [
        (e, cause, remedy)
        for cause, remedy, read in _READINGS
        if (e := _reprojection_error(read(T), first, second, views, model)) < _EXPLAINED
    ]
    better, cause, remedy = min(explained, default=(np.inf, "", ""))
    if better > _BETTER * error:
        cause = remedy = ""
    if baseline > _IMPOSSIBLE * distance:
        cause, remedy = cause or "it is in millimeters or centimeters", remedy or "give meters"
        raise InputError(
            f"relative_pose moves the camera by {baseline:.4g} m, but the object is about "
            f"{distance / 2:.2g} m away; probably {cause}: {remedy}"
        )
    if error < _NOISE or (error <= AGREEMENT and not cause):
        return error, []
    text = "the two views disagree about the pose"
    if cause:
        return error, [f"{text}, and would agree if relative_pose were right: probably {cause}: "
                       f"{remedy}"]  # fmt: skip
    return error, [
        f"{text}: the object is hidden or not there in one, it moved, or relative_pose or K is "
        "wrong"
    ]


def confidence(answer: PoseEstimate, error: float = 0.0) -> float:
    """Rates a pose from 0 to 1: its lowest detection score, less where the views disagree.

    It orders poses, and is no probability. ``error`` is that of `check_motion`.
    """
    score = min((float(roi.score) for roi in answer.rois), default=0.0)
    return score * float(np.exp(-((error / AGREEMENT) ** 2)))


def _reprojection_error(
    T: np.ndarray,
    first: PoseEstimate,
    second: PoseEstimate,
    views: Sequence[View],
    model: ObjectModel,
) -> float:
    """Returns how far one pose is from the keypoints of both views, if ``T`` relates them.

    The root mean square of the worse view in sides of its region; 1 at most for each keypoint.
    """
    Ks, poses = [view.K for view in views], [first, second]
    cameras = [np.eye(4), T]
    sides = [pose.rois[0].side for pose in poses]
    pixels = [
        project(transform(pose.T_cam_obj, model.keypoints), K)
        for pose, K in zip(poses, Ks, strict=True)
    ]
    covariances = [np.tile((_VOTE_STD * s) ** 2 * np.eye(2), (len(pixels[0]), 1, 1)) for s in sides]
    starts = [first.T_cam_obj, invert(T) @ second.T_cam_obj]
    errors = []
    for permutation in keypoint_permutations(model.keypoints, model.symmetries):
        seen = [pixels[0], pixels[1][permutation]]
        found = multi_view_pnp(
            model.keypoints, np.stack(seen), np.stack(covariances), Ks, cameras, starts
        )
        worst = 0.0
        for K, camera, side, given in zip(Ks, cameras, sides, seen, strict=True):
            points = transform(camera @ found.T_cam_obj, model.keypoints)
            off = np.ones((len(points), 2))
            if (points[:, 2] > 0.01).all():
                off = np.minimum(((project(points, K) - given) / side) ** 2, 1.0)
            worst = max(worst, float(np.sqrt(off.sum(axis=1).mean())))
        errors.append(worst)
    return min(errors)
