"""The command line: help, options, error messages, and the command `estimate`."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tyro
from PIL import Image
from scipy.spatial.transform import Rotation
from two_view_pose.__main__ import COMMANDS, find, main
from two_view_pose.assets import load_object
from two_view_pose.core.geometry import LINEMOD_K
from two_view_pose.pose_estimator.fusion import loading

OPTIONS = {
    "demo": "seed object scene policy device out json",
    "generate": "out scenes objects scene seed workers",
    "check-data": "split scenes images out overlays json",
    "train-estimator": "data out objects split stages init seed",
    "evaluate": "method weights preset solver roi scene objects data pairs csv score device json",
    "estimate": "reference second K relative-pose object method depth weights device out json",
    "record-bank": "out scenes scene seed objects estimator estimates data device workers verify",
    "train-agent": "algo bank pretrained-extractor visibility-bank record steps out env scene "
    "seed device json",
    "evaluate-agent": "policy scene episodes seed seeds bank figures device json",
    "compare": "out quick methods weights compare-weights data device threads report-only",
    "doctor": "quick json",
}


def test_every_command_is_listed(capsys):
    assert main(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert set(OPTIONS) == set(COMMANDS)
    for command in OPTIONS:
        (line,) = [line for line in lines if line.startswith(f"  {command} ")]
        assert len(line) <= 88


@pytest.mark.parametrize("command", OPTIONS)
def test_help_names_the_options(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    words = set(capsys.readouterr().out.replace(",", " ").split())
    assert {f"--{option}" for option in OPTIONS[command].split()} <= words


def test_commands_in_the_readme_parse():
    text = (Path(__file__).parents[1] / "README.md").read_text().replace("\\\n", " ")
    commands = re.findall(r"^python -m two_view_pose (.+)$", text, flags=re.MULTILINE)
    assert len(commands) > 5
    for line in commands:
        command, *options = shlex.split(line, comments=True)
        tyro.cli(find(COMMANDS[command].config), args=options)


def test_help_imports_no_heavy_module():
    code = (
        "import sys; from two_view_pose.__main__ import main; main(['--help']);"
        "print([m for m in ('torch', 'mujoco', 'stable_baselines3', 'cv2') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.endswith("[]\n")


def test_no_command_prints_the_help_and_fails(capsys):
    assert main([]) == 2
    assert "usage:" in capsys.readouterr().out


def test_unknown_command(capsys):
    assert main(["evalute"]) == 2
    error = capsys.readouterr().err
    assert "'evalute'" in error and "evaluate-agent" in error


def test_unknown_option(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["doctor", "--nonsense"])
    assert stop.value.code == 2
    assert "--nonsense" in capsys.readouterr().err


@pytest.fixture
def inputs(tmp_path):
    """Files and options of a good call, to be changed."""
    rng = np.random.default_rng(0)
    for name in ("a.png", "b.png"):
        Image.fromarray(rng.integers(0, 255, (480, 640, 3), np.uint8)).save(tmp_path / name)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("y", 20, degrees=True).as_matrix()
    T[:3, 3] = -0.3, 0.02, 0.1
    (tmp_path / "T.json").write_text(json.dumps({"T_second_reference": T.tolist()}))
    (tmp_path / "K.json").write_text(json.dumps({"cam_K": LINEMOD_K.ravel().tolist()}))
    options = {
        "reference": tmp_path / "a.png",
        "second": tmp_path / "b.png",
        "K": tmp_path / "K.json",
        "relative-pose": tmp_path / "T.json",
        "object": "can",
        "out": tmp_path / "pose.json",
        "overlay": tmp_path / "overlay.png",
        "json": tmp_path / "results.json",
    }
    return SimpleNamespace(folder=tmp_path, options=options, T=T)


def command(options):
    """The command line of `estimate` with these options."""
    pairs = [(f"--{name}", str(value)) for name, value in options.items() if value is not None]
    return ["estimate", *(word for pair in pairs for word in pair)]


def write(inputs, name, text):
    """Writes a text file and returns its path."""
    path = inputs.folder / name
    path.write_text(text)
    return path


def small_image(inputs):
    Image.new("RGB", (320, 240)).save(inputs.folder / "small.png")
    return inputs.folder / "small.png"


def depth_map(inputs, shape=(480, 640), suffix=".png", kind=np.uint16):
    """A depth map of 0.9 m everywhere but in a corner: whole millimeters, or meters."""
    depth = np.full(shape, 0.9 if kind == np.float32 else 900, kind)
    depth[:10, :10] = 0
    path = inputs.folder / f"depth{suffix}"
    if suffix == ".npy":
        np.save(path, depth)
    else:
        Image.fromarray(depth).save(path)
    return path


def blind_depth_map(inputs):
    """A depth map of a sensor that saw nothing."""
    blind = np.zeros((480, 640), np.float32)
    blind[::2], blind[1::4] = np.nan, np.inf
    np.save(inputs.folder / "blind.NPY.npy", blind)
    return (inputs.folder / "blind.NPY.npy").rename(inputs.folder / "blind.NPY")


SCALED = np.diag([1.1, 1.1, 1.1, 1.0]).tolist()
WRONG = {
    "no such image": (dict(reference=lambda i: i.folder / "no.png"), "no.png"),
    "not an image": (dict(second=lambda i: write(i, "x.png", "x")), "x.png is not an image"),
    "another size": (dict(second=small_image), "reference is 640x480, second is 320x240"),
    "K 2x2": (dict(K=lambda i: write(i, "K.txt", "1 2\n3 4\n")), "K.txt must be a 3x3"),
    "K no file": (dict(K=lambda i: "k.yml"), "K must be fx,fy,cx,cy"),
    "K no numbers": (dict(K=lambda i: "500,500,a,240"), "K must be four numbers"),
    "K NaN": (dict(K=lambda i: "500,nan,320,240"), "K has NaN"),
    "K of a larger image": (dict(K=lambda i: "1500,1500,960,540"), "principal point"),
    "K without its key": (dict(K=lambda i: write(i, "K2.json", "{}")), "none of the keys K, cam_K"),
    "pose not rigid": (
        {"relative-pose": lambda i: write(i, "T2.json", json.dumps(SCALED))},
        "T2.json is not rigid",
    ),
    "pose 3x3": (
        {"relative-pose": lambda i: write(i, "T.txt", "1 0 0\n0 1 0\n0 0 1\n")},
        "T.txt must be a 4x4",
    ),
    "pose no numbers": (
        {"relative-pose": lambda i: write(i, "T3.txt", "hello")},
        "holds no matrix of numbers",
    ),
    "rgbd without depth": (dict(method=lambda i: "rgbd"), "depth and the method rgbd go together"),
    "depth for mid": (dict(depth=lambda i: depth_map(i)), "depth and the method rgbd go together"),
    "depth is a photograph": (
        dict(method=lambda i: "rgbd", depth=lambda i: i.folder / "a.png"),
        "must be one channel of 16 bits",
    ),
    "depth is not an image": (
        dict(method=lambda i: "rgbd", depth=lambda i: write(i, "d.png", "x")),
        "neither an image file nor a .npy",
    ),
    "depth of another size": (
        dict(method=lambda i: "rgbd", depth=lambda i: depth_map(i, (240, 320))),
        "depth must have the image",
    ),
    "depth in the wrong unit": (
        {
            "method": lambda i: "rgbd",
            "depth": lambda i: depth_map(i),
            "depth-unit": lambda i: 1.0,
        },
        "has an implausible median of 900 m",
    ),
    "depth without a known pixel": (
        dict(method=lambda i: "rgbd", depth=blind_depth_map),
        "has no known pixel: all are 0, NaN or infinite",
    ),
    "depth in no unit": (
        {"method": lambda i: "rgbd", "depth": lambda i: depth_map(i), "depth-unit": lambda i: 0},
        "depth_unit must be positive",
    ),
    "overlay of no image": (dict(overlay=lambda i: i.folder / "o.txt"), "overlay must end in .png"),
    "overlay is a folder": (dict(overlay=lambda i: i.folder), "overlay must be a file"),
    "no relative pose": ({"relative-pose": lambda i: None}, "second and relative_pose go together"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_inputs_end_in_one_line(case, inputs, capsys):
    changed, expected = WRONG[case]
    options = inputs.options | {name: make(inputs) for name, make in changed.items()}
    assert main(command(options)) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert expected in error
    assert not inputs.options["out"].exists()


def test_debug_keeps_the_traceback(inputs):
    with pytest.raises(ValueError, match="K must be four numbers"):
        main(["--debug", *command(inputs.options | {"K": "a,b,c,d"})])


class KnownPose:
    """Returns one pose and records the views."""

    object_names = ("can",)
    networks = SimpleNamespace(objects={"can": load_object("can")})
    depth_use = None

    def __init__(self, T_cam_obj):
        self.T_cam_obj = T_cam_obj

    views = ()

    def estimate(self, views, object_name):
        self.views = max(self.views, views, key=len)
        return SimpleNamespace(
            T_cam_obj=self.T_cam_obj,
            keypoints=load_object(object_name).keypoints + self.T_cam_obj[:3, 3],
            keypoint_covariance=np.tile(np.eye(3) * 1e-6, (9, 1, 1)),
            rois=[SimpleNamespace(center=np.array([300.0, 200.0]), side=90.0, score=0.5)] * 2,
            depth_use=self.depth_use,
        )


def test_estimate_hands_over_the_views_and_draws_the_pose(inputs, monkeypatch, capsys):
    T_cam_obj = np.eye(4)
    T_cam_obj[:3, 3] = 0.05, -0.03, 0.9
    estimator = KnownPose(T_cam_obj)
    monkeypatch.setattr(loading, "load", lambda method, weights, device: estimator)
    assert main(command(inputs.options)) == 0

    reference, second = estimator.views
    np.testing.assert_array_equal(reference.image, Image.open(inputs.options["reference"]))
    np.testing.assert_allclose(reference.K, LINEMOD_K)
    np.testing.assert_allclose(
        second.T_cam_world @ np.linalg.inv(reference.T_cam_world), inputs.T, atol=1e-12
    )
    pose = json.loads(inputs.options["out"].read_text())
    np.testing.assert_allclose(pose["T_cam_obj"], T_cam_obj, atol=1e-8)
    np.testing.assert_allclose(pose["keypoint_deviation_m"], np.sqrt(3e-6))
    # The same pose in both cameras disagrees with a camera that moved.
    assert 0 <= pose["confidence"] < 0.5 and "views disagree" in pose["warnings"][0]

    drawn = np.asarray(Image.open(inputs.options["overlay"])).astype(int)
    assert drawn.shape == (480, 1280, 3)
    changed = np.any(drawn[:, :640] != reference.image, axis=2)
    u, v = (LINEMOD_K @ T_cam_obj[:3, 3])[:2] / T_cam_obj[2, 3]
    rows, columns = np.nonzero(changed)
    assert abs((columns.min() + columns.max()) / 2 - u) < 10
    assert abs((rows.min() + rows.max()) / 2 - v) < 10
    assert np.any(drawn[:, 640:] != second.image)

    results = json.loads(inputs.options["json"].read_text())
    metrics = [record["metric"] for record in results["records"]]
    assert metrics.count("detection_score") == 2 and "seconds_per_pair" in metrics
    out, err = capsys.readouterr()
    assert "x +0.0500, y -0.0300, z +0.9000 m" in out and "confidence: 0." in out
    assert [f"warning: {doubt}" for doubt in pose["warnings"]] == err.splitlines()


def test_estimate_from_one_photograph(inputs, monkeypatch):
    estimator = KnownPose(np.eye(4))
    monkeypatch.setattr(loading, "load", lambda method, weights, device: estimator)
    alone = {"second": None, "relative-pose": None, "K": "572.4114,573.57043,325.2611,242.04899"}
    assert main(command(inputs.options | alone)) == 0
    (view,) = estimator.views
    np.testing.assert_allclose(view.K, LINEMOD_K)


@pytest.mark.parametrize(
    ("suffix", "kind"),
    [(".png", np.uint16), (".tif", np.uint16), (".npy", np.uint16), (".npy", np.float32)],
)
def test_estimate_from_a_photograph_with_depth(inputs, monkeypatch, suffix, kind):
    estimator = KnownPose(np.eye(4))
    monkeypatch.setattr(loading, "load", lambda method, weights, device: estimator)
    options = {"second": None, "relative-pose": None, "method": "rgbd"}
    options["depth"] = depth_map(inputs, suffix=suffix, kind=kind)
    assert main(command(inputs.options | options)) == 0
    (view,) = estimator.views
    assert view.depth.shape == (480, 640) and view.depth[0, 0] == 0
    np.testing.assert_allclose(view.depth[20:], 0.9, atol=1e-6)
