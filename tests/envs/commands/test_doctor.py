"""The command ``doctor`` says what works here, what networks run on, and what to do."""

import json
import re

import pytest
import torch
from two_view_pose.__main__ import main
from two_view_pose.assets import OBJECT_NAMES
from two_view_pose.envs.commands import doctor


@pytest.mark.slow
def test_doctor_reports_the_opengl_backend(tmp_path, capsys):
    assert main(["doctor", "--quick", "--json", str(tmp_path / "d.json")]) == 0
    assert "ok  OpenGL" in capsys.readouterr().out
    (record,) = json.loads((tmp_path / "d.json").read_text())["records"]
    assert record["check"] == "OpenGL" and record["value"] == 1


@pytest.mark.slow
def test_doctor_reports_a_failed_check(monkeypatch, capsys):
    monkeypatch.setenv("MUJOCO_GL", "off")
    assert main(["doctor", "--quick"]) == 1
    printed = capsys.readouterr().out
    assert "FAIL  OpenGL: MUJOCO_GL=off disables rendering; unset it" in printed


def test_doctor_says_what_networks_run_on(monkeypatch):
    monkeypatch.setenv("ATEN_CPU_CAPABILITY", "avx2")
    found = {check.name: check.text for check in doctor.check_computing()}
    assert list(found) == ["device", "processor", "kernels", "threads"]
    assert found["device"].startswith("auto means ")
    assert "limited by ATEN_CPU_CAPABILITY=avx2" in found["kernels"]
    assert f"{torch.backends.cpu.get_cpu_capability()} kernels" in found["kernels"]
    assert found["threads"].startswith(f"{torch.get_num_threads()} by default; they ")


@pytest.mark.slow
def test_doctor_times_estimates():
    check = doctor.check_estimator("single")
    assert check.passed
    objects, milliseconds = re.fullmatch(
        r"(\d+) objects, (\d+) ms a pair, median of 5", check.text
    ).groups()
    assert int(objects) == len(OBJECT_NAMES) and int(milliseconds) > 0
