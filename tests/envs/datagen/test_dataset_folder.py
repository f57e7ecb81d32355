"""A folder keeps its settings, and nothing that a killed run left."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from two_view_pose.envs.datagen.dataset_folder import remove_leftovers
from two_view_pose.envs.datagen.generate import GenerateConfig, write_manifest


def test_a_folder_keeps_its_settings(tmp_path: Path) -> None:
    config = GenerateConfig(tmp_path, distractors=("cat",), sampling="stereo")
    write_manifest(config, ("duck", "cat"))
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["settings"]["objects"] == ["duck"]
    assert manifest["settings"]["distractors"] == ["cat"]
    assert manifest["scenes"] == 100 and manifest["checksums"] == "SHA256SUMS"
    write_manifest(replace(config, workers=7, coco=True, shard=(1, 3)), ("duck", "cat"))
    for change, message in (
        ({"annotations": "basic"}, "annotations is 'full' there, 'basic' here"),
        ({"stereo_baseline": 0.1}, r"stereo_baseline is 0\.12 there, 0\.1 here"),
        ({"sampling": "sphere"}, "sampling is 'stereo' there, 'sphere' here"),
    ):
        with pytest.raises(ValueError, match=message):
            write_manifest(replace(config, **change), ("duck", "cat"))


def test_settings_that_a_sampling_does_not_use_may_change(tmp_path: Path) -> None:
    write_manifest(GenerateConfig(tmp_path, stereo_baseline=0.2, gaps=(2,)), ("duck",))
    write_manifest(GenerateConfig(tmp_path), ("duck",))


def test_leftovers_of_killed_runs_go_and_those_of_living_ones_stay(tmp_path: Path) -> None:
    child = subprocess.Popen([sys.executable, "-c", "pass"])
    child.wait()
    dead = tmp_path / f".camera.json.{child.pid}.tmp"
    own = tmp_path / f".camera.json.{os.getpid()}.tmp"
    living = tmp_path / f".camera.json.{os.getppid()}.tmp"
    kept = [living, tmp_path / "camera.json", tmp_path / ".hidden", tmp_path / "a.1.tmp"]
    for path in (dead, own, *kept):
        path.touch()
    remove_leftovers(tmp_path, tmp_path / "there is none")
    assert sorted(tmp_path.iterdir()) == sorted(kept)
