"""Digests change when what they are of changes, and only then."""

import sys
from pathlib import Path

from study_cases import Oracle
from two_view_pose.pose_estimator import study_fingerprint
from two_view_pose.pose_estimator.late_fusion import LateFusionEstimator
from two_view_pose.pose_estimator.mid_fusion import MidFusionEstimator
from two_view_pose.pose_estimator.study_fingerprint import PARTS, of_code, of_file, of_networks


def test_numbers_of_the_parts_that_a_method_uses(networks):
    before = {method: of_networks(networks, parts) for method, parts in PARTS.items()}
    bias = networks.volume.fine.output.bias
    bias.data += 1
    try:
        after = {method: of_networks(networks, parts) for method, parts in PARTS.items()}
    finally:
        bias.data -= 1
    assert [method for method in PARTS if after[method] != before[method]] == ["mid"]
    assert of_networks(networks, PARTS["mid"]) == before["mid"]


def test_files(tmp_path):
    (tmp_path / "a").write_text("1")
    (tmp_path / "b").write_text("1")
    assert of_file(tmp_path / "a") == of_file(tmp_path / "b")
    (tmp_path / "b").write_text("2")
    assert of_file(tmp_path / "a") != of_file(tmp_path / "b")


def test_a_method_is_made_of_what_it_imports():
    used = {
        name.rsplit(".", 1)[-1]
        for name in study_fingerprint._used_by(MidFusionEstimator.__module__)
    }
    assert {"mid_fusion", "two_view", "frontend", "volume", "solvers", "voting", "geometry"} <= used
    assert not {"late_fusion", "training", "study_fingerprint", "report"} & used


def test_a_changed_file_changes_the_methods_made_of_it(tmp_path, monkeypatch):
    def changed(module: str) -> list[bool]:
        loaded = sys.modules[f"two_view_pose.pose_estimator.{module}"]
        copy = tmp_path / f"{module}.py"
        copy.write_text(Path(loaded.__file__).read_text() + "\n# changed")
        with monkeypatch.context() as patch:
            patch.setattr(loaded, "__file__", str(copy))
            return [of_code(method) != code for method, code in before.items()]

    before = {method: of_code(method) for method in (MidFusionEstimator, LateFusionEstimator)}
    assert changed("mid_fusion") == [True, False]
    assert changed("voting") == [True, True]
    assert changed("study_fingerprint") == [False, False]


def test_methods_from_elsewhere_have_a_digest_too():
    assert of_code(Oracle) != of_code(MidFusionEstimator)
