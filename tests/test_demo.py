"""The command `demo`."""

import json

import numpy as np
import pytest
from helpers.estimators import ConstantEstimator
from PIL import Image
from two_view_pose.__main__ import main
from two_view_pose.assets import OBJECT_NAMES, load_object
from two_view_pose.envs import protocol


def test_demo_needs_a_policy_with_a_second_view(capsys):
    with pytest.raises(SystemExit):
        main(["demo", "--policy", "stay"])
    error = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert "policy must take a second view, got 'stay'" in error


class ImprovingEstimator(ConstantEstimator):
    """Returns a pose that is 40 mm deeper from one view than from two."""

    object_names = OBJECT_NAMES

    def estimate(self, views, object_name):
        estimate = super().estimate(views, object_name)
        estimate.T_cam_obj[2, 3] += 0.04 if len(views) == 1 else 0.0
        return estimate


@pytest.mark.slow
def test_demo_writes_an_image_and_the_errors(tmp_path, monkeypatch, capsys):
    T_cam_obj = np.eye(4)
    T_cam_obj[:3, 3] = 0.0, 0.0, 0.4  # nearer than any object is
    monkeypatch.setattr(
        protocol, "load_shipped", lambda method, device: ImprovingEstimator(T_cam_obj)
    )
    image, results = tmp_path / "demo.jpg", tmp_path / "demo.json"
    frames = []
    for _ in range(2):
        command = f"demo --object can --seed 3 --out {image} --json {results}"
        assert main(command.split()) == 0
        frames.append(image.read_bytes())
    assert frames[0] == frames[1]
    with Image.open(image) as picture:
        assert picture.format == "JPEG" and picture.width >= 1280

    records = json.loads(results.read_text())["records"]
    ratios = [r["value"] for r in records if r["metric"] == "add_over_diameter"]
    # The first pose lies 40 mm deeper, that is nearer to the object.
    assert 0.01 < (ratios[1] - ratios[0]) * load_object("can").diameter <= 0.04
    printed = capsys.readouterr().out
    assert f"{100 * ratios[0]:.1f} %" in printed and f"{100 * ratios[1]:.1f} %" in printed
