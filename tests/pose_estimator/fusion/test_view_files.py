"""The command ``estimate`` reads photographs as OpenCV does, and says what it doubts."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from two_view_pose.core.errors import InputError
from two_view_pose.core.geometry import LINEMOD_K
from two_view_pose.pose_estimator.fusion.estimate_config import EstimateConfig
from two_view_pose.pose_estimator.fusion.view_files import read_depth, read_views

SQUARE_K = "500,500,99.5,99.5"
MOVED = [[1, 0, 0, -0.3], [0, 1, 0, 0], [0, 0, 1, 0]]


def photograph(folder: Path, name: str, orientation: int, seed: int, size: tuple[int, int]) -> Path:
    """A photograph of ``size`` (W, H) with an EXIF orientation."""
    coarse = np.random.default_rng(seed).integers(0, 255, (5, 5, 3), np.uint8)
    image = Image.fromarray(cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC))
    exif = Image.Exif()
    exif[274] = orientation
    image.save(folder / name, exif=exif)
    return folder / name


@pytest.fixture
def config(tmp_path):
    """Makes the options from two orientations."""
    (tmp_path / "T.json").write_text(json.dumps(MOVED))

    def make(first: int, second: int, size: tuple[int, int] = (200, 200), K: str = SQUARE_K):
        paths = [
            photograph(tmp_path, name, orientation, seed, size)
            for name, orientation, seed in (("a.png", first, 0), ("b.png", second, 1))
        ]
        return EstimateConfig(*paths[:1], "can", K, paths[1], tmp_path / "T.json")

    return make


@pytest.mark.parametrize("orientation", range(1, 9))
def test_photographs_are_turned_upright_as_by_opencv(config, orientation, capsys):
    given = config(orientation, orientation)
    views, doubts = read_views(given)
    for view, path in zip(views, (given.reference, given.second), strict=True):
        expected = cv2.imread(str(path))[..., ::-1]
        np.testing.assert_array_equal(view.image, expected)
    assert doubts == []
    said = f"a.png has the EXIF orientation {orientation} and is turned upright"
    assert (said in capsys.readouterr().out) == (orientation > 1)


@pytest.mark.parametrize("pair", [(1, 3), (6, 8), (2, 1), (5, 6)])
def test_different_orientations_are_doubted(config, pair):
    _, (doubt,) = read_views(config(*pair))
    assert f"different EXIF orientations ({pair[0]} and {pair[1]})" in doubt


def test_sizes_that_differ_after_turning(config):
    K = "500,500,149.5,99.5"
    with pytest.raises(InputError, match=r"300x200, second is 200x300 \(after turning .* 1 and 6"):
        read_views(config(1, 6, (300, 200), K))
    views, _ = read_views(config(6, 6, (200, 300), K))
    assert views[0].image.shape == (200, 300, 3)


def test_a_depth_map_is_not_turned(config, tmp_path):
    cv2.imwrite(str(tmp_path / "d.png"), np.full((200, 200), 900, np.uint16))
    reference = config(3, 3).reference
    given = EstimateConfig(reference, "can", SQUARE_K, method="rgbd", depth=tmp_path / "d.png")
    depth = read_depth(given)
    assert depth is not None
    _, (doubt,) = read_views(given, depth.meters)
    assert "its depth map is not" in doubt


def test_the_size_in_a_camera_file_must_be_that_of_the_photographs(config, tmp_path):
    fx, fy, cx, cy = LINEMOD_K[0, 0], LINEMOD_K[1, 1], LINEMOD_K[0, 2], LINEMOD_K[1, 2]
    camera = dict(fx=fx, fy=fy, cx=cx, cy=cy, width=640, height=480)
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(camera))
    for K in (str(path), "linemod"):
        views, doubts = read_views(config(1, 1, (640, 480), K))
        np.testing.assert_allclose(views[1].K, LINEMOD_K)
        assert doubts == []
        with pytest.raises(InputError, match=r"640x480.* 1280x960: multiply .* by 2"):
            read_views(config(1, 1, (1280, 960), K))
        with pytest.raises(InputError, match="calibrate for them"):
            read_views(config(1, 1, (640, 640), K))
