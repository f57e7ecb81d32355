"""Usual mistakes with ``estimate`` on rendered photographs are named; correct input is not."""

import json
from contextlib import chdir
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from two_view_pose.__main__ import main
from two_view_pose.core.geometry import invert, make_transform
from two_view_pose.pose_estimator.bop.dataset import read_dataset, read_rgb
from two_view_pose.pose_estimator.bop.pairs import read_pairs

pytestmark = pytest.mark.slow
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Two photographs of an ape, their camera and motion."""
    folder = tmp_path_factory.mktemp("pair")
    options = "--split test --scenes 1 --views 2 --view-angles 10 60 --seed 3 --workers 1"
    assert main(["generate", "--out", str(folder / "data"), *options.split()]) == 0
    (pair,) = read_pairs(folder / "data")
    scene = read_dataset(folder / "data", "test").scene(pair.scene_id)
    views = [scene[pair.ref_image_id], scene[pair.second_image_id]]
    for name, view in zip("ab", views, strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), read_rgb(view)[..., ::-1])
    truth = views[0].annotation(pair.target_obj_id).T_cam_obj
    return SimpleNamespace(folder=folder, K=views[0].K, T=pair.T_second_ref, truth=truth)


@pytest.fixture(autouse=True)
def in_folder(pair):
    with chdir(pair.folder):
        yield


def estimate(pair, capsys, change=lambda image: image, T=None, K=None, name="ape", order="ab"):
    """Returns exit code, what is written and what is printed to stderr."""
    Path("pose.json").unlink(missing_ok=True)
    for file in "ab":
        image = cv2.imread(f"{file}.png")
        cv2.imwrite(f"{file}_given.png", change(image))
    np.savetxt("T.txt", pair.T[:3] if T is None else T, fmt="%.4f")
    np.savetxt("K.txt", pair.K if K is None else K)
    images = [f"{file}_given.png" for file in order]
    code = main(
        ["estimate", "--reference", images[0], "--second", images[1], "--K", "K.txt",
         "--relative-pose", "T.txt", "--object", name]
    )  # fmt: skip
    out = json.loads(Path("pose.json").read_text()) if code == 0 else None
    return code, out, capsys.readouterr().err


def scaled(T: np.ndarray, factor: float) -> np.ndarray:
    return make_transform(T[:3, :3], factor * T[:3, 3])


@pytest.mark.parametrize(
    "change", [lambda image: image, lambda image: image.astype(np.uint16) << 8]
)
def test_correct_input_raises_no_doubt(pair, capsys, change):
    code, pose, err = estimate(pair, capsys, change)
    assert code == 0 and err == "" and pose["warnings"] == [] and pose["confidence"] > 0.5
    off = np.array(pose["T_cam_obj"])[:3, 3] - pair.truth[:3, 3]
    assert np.linalg.norm(off) < 0.01


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (dict(T=lambda p: scaled(p.T, 1e3)), "millimeters"),
        (dict(T=lambda p: scaled(p.T, 1e2)), "centimeters"),
        (dict(T=lambda p: OPENGL @ p.T @ OPENGL), "OpenGL"),
        (dict(T=lambda p: invert(p.T)), "inverted"),
        (dict(T=lambda p: np.eye(4)), "identity"),
        (dict(order=lambda p: "ba"), "the photographs are swapped"),
        (dict(order=lambda p: "aa"), "the same photograph"),
        (dict(name=lambda p: "benchvise"), "benchvise is hardly seen"),
        (dict(change=lambda p: lambda i: cv2.resize(i, None, fx=2, fy=2)), "0.5 times as large"),
        (dict(change=lambda p: lambda i: cv2.cvtColor(i, cv2.COLOR_BGR2GRAY)), "is gray"),
        (dict(change=lambda p: lambda i: i.astype(np.uint16) << 4), "nearly black"),
        (dict(K=lambda p: np.diag([2, 2, 1]) @ p.K), "images 2 times as large"),
        (dict(K=lambda p: p.K.T), "transposed"),
    ],
)
def test_mistakes_are_named(pair, capsys, wrong, words):
    code, pose, err = estimate(pair, capsys, **{key: make(pair) for key, make in wrong.items()})
    assert words in err
    assert all(line.startswith(("error: ", "warning: ")) for line in err.splitlines())
    assert code == 2 or pose["confidence"] < 0.2
