"""Result files of others: the mistake that makes all poses wrong is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.solid_scenes import write_dataset
from scipy.spatial.transform import Rotation
from two_view_pose.__main__ import main
from two_view_pose.core.geometry import invert, make_transform
from two_view_pose.pose_estimator.bop.dataset import read_dataset
from two_view_pose.pose_estimator.bop.results import BopResult, write_bop_results


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("explain") / "solids"
    write_dataset(root)
    return root


def estimates(root: Path) -> list[BopResult]:
    """Poses as good as a method's: within a few degrees and millimeters."""
    rng = np.random.default_rng(0)
    return [
        BopResult(image.scene_id, image.image_id, a.obj_id, 1.0, a.T_cam_obj @ make_transform(
            Rotation.from_rotvec(rng.normal(0, 0.03, 3)).as_matrix(), rng.normal(0, 0.002, 3)))
        for image in read_dataset(root)
        for a in image.annotations
    ]  # fmt: skip


def posed(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[BopResult], BopResult]:
    return lambda result: replace(result, T_cam_obj=change(result.T_cam_obj))


def scaled(factor: float) -> Callable[[BopResult], BopResult]:
    return posed(lambda T: make_transform(T[:3, :3], factor * T[:3, 3]))


def reordered(T: np.ndarray) -> np.ndarray:
    """The rotation of a quaternion w, x, y, z that is read as x, y, z, w."""
    wxyz = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
    return make_transform(Rotation.from_quat(wxyz).as_matrix(), T[:3, 3])


def frame(result: BopResult) -> BopResult:
    """Of models whose origin is a corner and whose axes are turned."""
    turn = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    return replace(result, T_cam_obj=result.T_cam_obj @ make_transform(turn, np.full(3, 0.06)))


NUMBERS = {1: 4, 4: 7, 7: 1}
MISTAKES = {
    "meters": (scaled(0.001), "t is in meters"),
    "centimeters": (scaled(0.1), "t is in centimeters"),
    "scaled twice": (scaled(1000.0), "t was scaled by 1000 twice"),
    "transposed": (
        posed(lambda T: make_transform(T[:3, :3].T, T[:3, 3])), "the rotation is transposed"
    ),
    "inverted": (posed(invert), "the pose is inverted"),
    "opengl": (posed(lambda T: np.diag([1.0, -1, -1, 1]) @ T), "axes are OpenGL"),
    "quaternion": (posed(reordered), "order w, x, y, z that was read as x, y, z, w"),
    "meters, inverted": (
        posed(lambda T: make_transform(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3] / 1000)),
        "t is in meters; BOP has millimeters; and the pose is inverted",
    ),
    "frame": (frame, "they are of models in another frame (object 1 is"),
    "numbers": (
        lambda r: replace(r, obj_id=NUMBERS[r.obj_id]), "other numbers (1 is 7, 4 is 1, 7 is 4)"
    ),
    "images": (lambda r: replace(r, image_id=(r.image_id + 1) % 4), "im_id is off by -1"),
}  # fmt: skip


def printed(root: Path, results: list[BopResult], tmp_path: Path, capsys) -> str:
    path = tmp_path / "theirs_solids-test.csv"
    write_bop_results(path, results)
    assert main(["evaluate", "--data", str(root), "--score", str(path)]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("case", MISTAKES)
def test_the_mistake_is_named(case, root, tmp_path, capsys):
    change, words = MISTAKES[case]
    out = printed(root, [change(result) for result in estimates(root)], tmp_path, capsys)
    assert "warning: of 24 estimates, " in out and words in out.split("warning:")[1]
    assert "score the file again" in out


def test_right_and_plainly_wrong_files_have_no_warning(root, tmp_path, capsys):
    good = estimates(root)
    assert "warning" not in printed(root, good, tmp_path, capsys)
    rng = np.random.default_rng(1)
    places = rng.uniform((-0.3, -0.2, 0.5), (0.3, 0.2, 1.2), (len(good), 3))
    turns = Rotation.random(len(good), rng=rng).as_matrix()
    poses = [make_transform(R, t) for R, t in zip(turns, places, strict=True)]
    bad = [replace(r, T_cam_obj=T) for r, T in zip(good, poses, strict=True)]
    assert "warning" not in printed(root, bad, tmp_path, capsys)
    assert "warning" not in printed(root, [], tmp_path, capsys)
