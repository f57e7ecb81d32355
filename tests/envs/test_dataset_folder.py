"""A folder goes on as it began, and keeps nothing that a killed run left."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from two_view_pose.envs.dataset_folder import claim_folder, remove_leftovers
from two_view_pose.envs.generate import GenerateConfig

OLD = {
    "views": 4, "objects": ["duck"], "scene": "mixed", "split": "train_pbr", "seed": 0,
    "width": 640, "height": 480, "view_angles": [10.0, 75.0], "pair_angles": [10.0, 60.0],
    "depth": False, "depth_noise": False, "masks": True, "jpeg_quality": 92, "randomize": True,
}  # fmt: skip
"""The settings in a folder of the version before layouts."""


def old_folder(folder: Path, **settings) -> GenerateConfig:
    content = {"settings": OLD | settings, "scenes": 7, "versions": {}}
    (folder / "manifest.json").write_text(json.dumps(content))
    return GenerateConfig(folder)


def test_an_older_folder_goes_on_as_it_began(tmp_path: Path) -> None:
    config = old_folder(tmp_path)
    assert config.layout == "full"
    assert claim_folder(config, ("duck",)) == replace(config, layout="basic")
    settings = json.loads((tmp_path / "manifest.json").read_text())["settings"]
    assert settings == OLD
    assert claim_folder(config, ("duck",)).layout == "basic"  # and so on


def test_older_sequences_are_known_too(tmp_path: Path) -> None:
    frames = {"sampling": "hand-held", "gaps": [1, 5], "references": 2, "views": 9}
    config = replace(
        old_folder(tmp_path, **frames), sampling="hand-held", gaps=(1, 5), references=2, views=9
    )
    assert claim_folder(config, ("duck",)).layout == "basic"
    settings = json.loads((tmp_path / "manifest.json").read_text())["settings"]
    assert settings == OLD | frames
    with pytest.raises(ValueError, match="references is 2 there, 3 here"):
        claim_folder(replace(config, references=3), ("duck",))


def test_a_new_folder_keeps_its_layout(tmp_path: Path) -> None:
    config = claim_folder(GenerateConfig(tmp_path), ("duck",))
    assert config.layout == "full"
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["settings"]["layout"] == "full" and manifest["checksums"] == "SHA256SUMS"
    with pytest.raises(ValueError, match="layout is 'full' there, 'basic' here"):
        claim_folder(replace(config, layout="basic"), ("duck",))


def test_the_baseline_of_a_rig_is_fixed(tmp_path: Path) -> None:
    config = GenerateConfig(tmp_path, sampling="stereo", stereo_baseline=0.12)
    claim_folder(config, ("duck",))
    claim_folder(replace(config, workers=7, coco=True, ray="local"), ("duck",))
    with pytest.raises(ValueError, match=r"stereo_baseline is 0\.12 there, 0\.1 here"):
        claim_folder(replace(config, stereo_baseline=0.1), ("duck",))
    with pytest.raises(ValueError, match="sampling is 'stereo' there, 'sphere' here"):
        claim_folder(GenerateConfig(tmp_path), ("duck",))


def test_an_older_folder_cannot_have_coco(tmp_path: Path) -> None:
    config = replace(old_folder(tmp_path), coco=True)
    with pytest.raises(ValueError, match="an older version began does not have"):
        claim_folder(config, ("duck",))


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
