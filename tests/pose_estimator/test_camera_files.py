"""Camera matrices and relative poses in the files that other tools write."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.core.errors import InputError, InputWarning
from two_view_pose.pose_estimator.camera_files import parse_intrinsics, read_relative_pose

K = np.array([[572.4, 0.0, 325.3], [0.0, 573.6, 242.0], [0.0, 0.0, 1.0]])
T = np.eye(4)
T[:3, :3] = Rotation.from_euler("xyz", [10, 30, -50], degrees=True).as_matrix()
T[:3, 3] = -0.3, 0.02, 0.1
CAMERA = dict(fx=572.4, fy=573.6, cx=325.3, cy=242.0, depth_scale=1.0, width=640, height=480)
ROS = """image_width: 640
image_height: 480
camera_matrix:
  rows: 3
  cols: 3
  data: [572.4, 0, 325.3, 0, 573.6, 242.0, 0, 0, 1]
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0, 0, 0, 0, 0]
"""
PROJECTION = np.column_stack([K, np.zeros(3)])


def written(path: Path, content: object) -> Path:
    """Writes text, JSON, an array, or what OpenCV's FileStorage writes."""
    if path.suffix.lower() == ".npy":
        with path.open("wb") as stream:  # np.save appends .npy to .NPY
            np.save(stream, content)
    elif path.suffix == ".npz":
        np.savez(path, **content)
    elif path.suffix == ".txt" and isinstance(content, np.ndarray):
        np.savetxt(path, content)
    elif path.suffix in (".yml", ".xml"):
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        for key, value in content.items():
            storage.write(key, value)
        storage.release()
    else:
        path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("name", "content", "size"),
    [
        ("camera.json", CAMERA, (480, 640)),
        ("scene_camera.json", {i: {"cam_K": K.ravel().tolist()} for i in "07"}, None),
        ("K.json", {"camera_matrix": K.tolist(), "dist_coeffs": [0.0] * 5}, None),
        ("K.json", K.ravel().tolist(), None),
        ("K.json", {"K": K.ravel().tolist(), "D": [], "width": 640, "height": 480}, (480, 640)),
        ("K.json", [572.4, 573.6, 325.3, 242.0], None),
        ("K.txt", PROJECTION, None),
        ("K.npy", np.vstack([PROJECTION, [0, 0, 0, 1]]), None),
        ("K.NPY", K, None),
        ("K.npz", {"K": K}, None),
        ("K.yml", {"image_width": 640, "image_height": 480, "camera_matrix": K}, (480, 640)),
        ("K.xml", {"cameraMatrix": K, "distCoeffs": np.zeros(5)}, None),
        ("ros.yaml", ROS, (480, 640)),
    ],
)  # fmt: skip
def test_camera_matrices(tmp_path, recwarn, name, content, size):
    camera = parse_intrinsics(str(written(tmp_path / name, content)))
    np.testing.assert_allclose(camera.K, K)
    assert camera.size == size and not recwarn.list


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("K.json", K.T.ravel().tolist(), "transposed: MATLAB"),
        ("K.json", {"0": {"cam_K": [1] * 9}, "1": {"cam_K": [2] * 9}}, "different cameras"),
        ("K.json", CAMERA | {"fx": "wide"}, "must be numbers"),
        ("K.json", [[1, 2], [3]], "no matrix of numbers"),
        ("K.json", "null", "must be a 3x3"),
        ("K.txt", PROJECTION + np.eye(3, 4, 3), "projection matrix"),
        ("K.yml", {"zoom": 2.0}, "none of the keys"),
        ("K.xml", {"camera_matrix": -K}, "positive focal lengths"),
        ("K.yaml", ": not: yaml [", "no matrix of numbers"),
        ("K.npz", {"zoom": K}, "none of the keys"),
        ("K.npy", K * 1j, "complex"),
        ("K.json", "[" * 100_000, "no matrix of numbers"),
        ("K.json", [[10**400, 0, 0], [0, 1, 0], [0, 0, 1]], "no matrix of numbers"),
        ("K.json", CAMERA | {"fx": 10**400}, "must be numbers"),
        ("K.json", CAMERA | {"fx": -1}, "positive focal lengths"),
        ("K.json", [1, 1, 1, -1, 1, 1, 0, 0, float("nan")], "NaN"),
        ("K.txt", np.zeros((2, 2, 2)).ravel(), "must be a 3x3"),
    ],
)
def test_other_files_are_refused_by_name(tmp_path, name, content, match):
    with pytest.raises(InputError, match=f"{re.escape(name)}.*{match}"):
        parse_intrinsics(str(written(tmp_path / name, content)))


@pytest.mark.parametrize("name", ["K.npy", "K.npz", "K.json", "K.xml", "K.yml"])
@pytest.mark.parametrize("read", [lambda path: parse_intrinsics(str(path)), read_relative_pose])
def test_truncated_files_are_refused(tmp_path, name, read):
    plain = {"K.npy": K, "K.json": K.tolist()}
    path = written(tmp_path / name, plain.get(name, {"K": K}))
    content = path.read_bytes()
    for share in (0, 0.1, 0.4, 0.7):
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError, match=name):
            read(path)


@pytest.mark.parametrize("key", ["D", "dist_coeffs", "distortion_coefficients", "k1"])
def test_distortion_is_not_ignored_in_silence(tmp_path, key):
    path = written(tmp_path / "K.json", {"K": K.tolist(), key: [0.1, -0.2, 0, 0, 0]})
    with pytest.warns(InputWarning, match=r"undistort the photographs first"):
        parse_intrinsics(str(path))


@pytest.mark.parametrize("decimals", [3, 4, 6])
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("T.txt", lambda T: T),
        ("T.txt", lambda T: T[:3]),
        ("T.npy", lambda T: T[:3].ravel()),
        ("T.json", lambda T: {"T_second_reference": T.tolist()}),
        ("T.json", lambda T: {"R": T[:3, :3].tolist(), "t": T[:3, 3].tolist()}),
        ("T.yml", lambda T: {"R": T[:3, :3], "T": T[:3, 3:]}),
        (
            "T.json",
            lambda T: {
                "cam_R_ref2second": T[:3, :3].ravel().tolist(),
                "cam_t_ref2second": (1000 * T[:3, 3]).tolist(),
            },
        ),
    ],
)
def test_relative_poses_with_few_decimals(tmp_path, name, content, decimals):
    path = written(tmp_path / name, content(T.round(decimals)))
    found = read_relative_pose(path)
    np.testing.assert_allclose(found, T, atol=2 * 10.0**-decimals)
    # SciPy's rotation is orthonormal, whatever it is made of.
    nearest = Rotation.from_matrix(T.round(decimals)[:3, :3]).as_matrix()
    np.testing.assert_allclose(found[:3, :3], nearest, atol=1e-9)


@pytest.mark.parametrize(
    ("matrix", "match"),
    [
        (T.T, "transposed: its translation is in the last row"),
        (np.diag([1.1, 1.1, 1.1, 1.0]), "not rigid"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "not rigid"),
        (np.eye(3), "must be a 4x4"),
        (np.full((4, 4), np.nan), "NaN"),
    ],
)
def test_what_is_no_rigid_motion_is_refused(tmp_path, matrix, match):
    with pytest.raises(InputError, match=rf"T\.npy.*{match}"):
        read_relative_pose(written(tmp_path / "T.npy", matrix))
