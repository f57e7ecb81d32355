"""Text files of other programs: byte order marks, UTF-16, and endings in capitals."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from two_view_pose.agents.training.hyperparameters import load_hyperparameters
from two_view_pose.core.errors import InputError
from two_view_pose.core.results import read_results, write_results
from two_view_pose.core.text_files import read_text
from two_view_pose.pose_estimator.bop.fields import read_json
from two_view_pose.pose_estimator.bop.results import read_bop_results
from two_view_pose.pose_estimator.bop.scene import read_scene
from two_view_pose.pose_estimator.input_files import read_matrix

ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32")
K = [[500.5, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
ROW = "3,7,5,0.75,1 0 0 0 1 0 0 0 1,10 -20.5 800,0.125"


@pytest.fixture(params=ENCODINGS)
def written(request: pytest.FixtureRequest, tmp_path: Path):
    def write(name: str, text: str) -> Path:
        path = tmp_path / name
        path.write_bytes(text.replace("\n", "\r\n").encode(request.param))
        return path

    return write


@pytest.mark.parametrize("text", ["", "1", "1 2", "{}", '{"Schlüssel": "日本"}'])
def test_text_is_that_which_was_encoded(text, written):
    if len(text) != 1:  # a single character does not tell UTF-16 from UTF-8
        assert read_text(written("a.txt", text)) == text


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("K.txt", "# Schärfe\n500.5 0 320\n0 501 240\n0 0 1\n"),
        ("K.TXT", "500.5, 0, 320\n0, 501, 240\n0, 0, 1"),
        ("K.csv", "500.5,0,320\n0,501,240\n0,0,1"),
        ("K.json", json.dumps({"cam_K": np.ravel(K).tolist()})),
        ("K.JSON", json.dumps(K)),
    ],
)
def test_matrices(name, text, written):
    np.testing.assert_array_equal(read_matrix(written(name, text), "K", ("cam_K",)), K)


def test_matrix_of_an_array_file_with_an_ending_in_capitals(tmp_path):
    np.save(tmp_path / "K.npy", K)
    path = (tmp_path / "K.npy").rename(tmp_path / "K.NPY")
    np.testing.assert_array_equal(read_matrix(path, "K"), K)


def test_other_files_of_users(written, tmp_path):
    assert read_json(written("scene_gt.json", '{"0": []}'), dict) == {"0": []}
    (result,) = read_bop_results(written("a.csv", f"scene_id,im_id,obj_id,score,R,t,time\n{ROW}\n"))
    assert result.target == (3, 7, 5) and result.score == 0.75
    (result,) = read_bop_results(written("b.CSV", ROW))
    assert result.target == (3, 7, 5)
    text = "ppo:\n  TwoViewPose-v0:\n    n_steps: 32\n"
    entry = load_hyperparameters("ppo", "TwoViewPose-v0", written("h.yml", text))
    assert entry == {"n_steps": 32}
    write_results(tmp_path / "r.json", [], command="x", seed=None)
    path = written("r2.json", (tmp_path / "r.json").read_text())
    assert read_results(path) == read_results(tmp_path / "r.json")


@pytest.mark.parametrize(
    "content", [b"500 0 320 # Sch\xe4rfe", b"{\x00\xd8\x00\xd8", b"\xff\xfe\x00"]
)
def test_other_encodings_are_named(content, tmp_path):
    path = tmp_path / "K.txt"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"K.txt is not a text file in UTF-8 or UTF-16 .* at byte"):
        read_text(path)


def test_images_of_a_dataset_may_have_endings_in_capitals(tmp_path):
    folder = tmp_path / "000000"
    (folder / "rgb").mkdir(parents=True)
    Image.new("RGB", (64, 48)).save(folder / "rgb" / "000000.PNG")
    (folder / "scene_camera.json").write_text(json.dumps({"0": {"cam_K": np.ravel(K).tolist()}}))
    (folder / "scene_gt.json").write_text(json.dumps({"0": []}))
    scene = read_scene(folder, 0)
    assert scene is not None and scene.images[0].name == "000000.PNG"
