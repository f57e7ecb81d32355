"""The depth map of ``estimate``: its unit, and answers for which it was of no use."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from two_view_pose.core.errors import InputError
from two_view_pose.core.geometry import View
from two_view_pose.pose_estimator.fusion import loading
from two_view_pose.pose_estimator.fusion.estimate_files import EstimateConfig, estimate_files
from two_view_pose.pose_estimator.types import DepthUse, PoseEstimate

GOOD = DepthUse(points=500, share=0.9, distance=0.9, expected=0.95)


@pytest.fixture
def estimate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., View]:
    """Runs ``estimate`` with a method that answers with ``use``; returns the view it was given."""
    Image.new("RGB", (64, 48)).save(tmp_path / "a.png")

    def run(depth: Path, unit: float | None = None, use: DepthUse = GOOD) -> View:
        seen: list[View] = []

        def answer(views: list[View], name: str) -> PoseEstimate:
            seen.extend(views)
            covariance = np.tile(np.eye(3), (9, 1, 1))
            return PoseEstimate(np.eye(4), np.zeros((9, 3)), covariance, depth_use=use)

        estimator: Any = SimpleNamespace(estimate=answer)
        monkeypatch.setattr(loading, "load", lambda *_, **__: estimator)
        options: dict[str, Any] = {"method": "rgbd", "object": "can", "K": "60,60,32,24"}
        paths = {"out": tmp_path / "pose.json", "overlay": None, "reference": tmp_path / "a.png"}
        estimate_files(EstimateConfig(depth=depth, depth_unit=unit, **options, **paths))
        return seen[0]

    return run


@pytest.mark.parametrize("name", ["depth", "depth_tof"])
def test_depth_of_a_bop_dataset_has_its_unit(
    name: str,
    estimate: Callable[..., View],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "000003" / name).mkdir(parents=True)
    path = tmp_path / "000003" / name / "000012.png"
    Image.fromarray(np.full((48, 64), 9000, np.uint16)).save(path)  # 0.9 m, as we generate it
    camera = tmp_path / "000003" / f"scene_camera{name.removeprefix('depth')}.json"
    camera.write_text(json.dumps({"12": {"depth_scale": 0.1}}))
    np.testing.assert_allclose(estimate(path).depth, 0.9, atol=1e-6)
    assert "units of 0.0001 m" in capsys.readouterr().out
    np.testing.assert_allclose(estimate(path, unit=0.001).depth, 9.0, atol=1e-6)
    camera.write_text(json.dumps({"12": {"depth_scale": 0}}))
    with pytest.raises(InputError, match="depth_scale must be positive, got 0"):
        estimate(path)
    camera.unlink()
    np.testing.assert_allclose(estimate(path).depth, 9.0, atol=1e-6)


@pytest.mark.parametrize(
    ("use", "text"),
    [
        (DepthUse(0, 0.0, None, 0.9), "knows 0 points of can, 0 % of its pixels"),
        (DepthUse(3, 0.5, 0.9, 0.9), "knows 3 points of can, 50 % of its pixels, and rgbd needs"),
        (DepthUse(40, 0.02, 1.1, 0.9), "knows 40 points of can, 2 % of its pixels"),
        (DepthUse(500, 0.9, 0.009, 0.92), "0.0098 times.*--depth-unit 0.1 would fit"),
        (DepthUse(500, 0.9, 4.4, 0.9), "4.9 times.*--depth-unit 0.0002 would fit"),
    ],
)
def test_an_answer_without_depth_is_refused(
    use: DepthUse, text: str, estimate: Callable[..., View], tmp_path: Path
) -> None:
    Image.fromarray(np.full((48, 64), 900, np.uint16)).save(tmp_path / "d.png")
    with pytest.raises(InputError, match=text):
        estimate(tmp_path / "d.png", use=use)
    assert not (tmp_path / "pose.json").exists()
