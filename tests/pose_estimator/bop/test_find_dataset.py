"""Datasets are folders, or names below BOP_PATH."""

from __future__ import annotations

from pathlib import Path

import pytest
from two_view_pose.pose_estimator.bop.find_dataset import find_dataset


def test_existing_folder_has_priority_over_bop_path(tmp_path, monkeypatch):
    for folder in ("here/lmo", "bop/lmo", "bop/ycbv"):
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("BOP_PATH", str(tmp_path / "bop"))
    assert find_dataset("lmo") == Path("lmo")
    assert find_dataset(Path("ycbv")) == tmp_path / "bop" / "ycbv"


def test_missing_dataset_is_reported(tmp_path, monkeypatch):
    monkeypatch.delenv("BOP_PATH", raising=False)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=r"no dataset tless: .* set BOP_PATH"):
        find_dataset("tless")
    monkeypatch.setenv("BOP_PATH", str(tmp_path))
    with pytest.raises(ValueError, match=r"no dataset tless, nor a folder .*tless \(BOP_PATH\)"):
        find_dataset("tless")
    with pytest.raises(ValueError, match="no dataset /nowhere/tless"):
        find_dataset("/nowhere/tless")
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="is a file"):
        find_dataset("file")
