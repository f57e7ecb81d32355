"""The arithmetic of the soak script; the soak itself takes an hour and is run by hand."""

import json
import sys

import numpy as np
import pytest
import soak_memory
from scipy.stats import linregress


def test_the_slope_is_that_of_a_line():
    frames = np.arange(100, 5001, 100)
    assert soak_memory.slope(frames, 400_000_000 + 2_000 * frames) == pytest.approx(2_000)
    assert soak_memory.slope(frames, np.full(50, 400_000_000)) == pytest.approx(0, abs=1e-3)
    noisy = 400_000_000 + np.random.default_rng(0).normal(0, 1e6, 50)
    assert soak_memory.slope(frames, noisy) == pytest.approx(linregress(frames, noisy).slope)


def test_one_measurement_has_no_slope():
    with pytest.raises(ValueError, match="two measurements"):
        soak_memory.slope(np.array([100]), np.array([1]))


def test_the_warm_up_does_not_count():
    frames = np.arange(100, 1001, 100)
    memory = np.where(frames < 500, 1_000_000 * frames, 300_000_000)
    memory[-2] += 5_000_000
    found = soak_memory.summary(frames, memory, warm_up=500)
    assert (found["first_mb"], found["last_mb"], found["maximum_mb"]) == (300, 300, 305)
    assert 0 < found["slope_kb_per_1000_frames"] < 10_000


def test_the_script_measures_and_writes(tmp_path, monkeypatch, capsys):
    def pretend(options, folder, frames, memory):
        frames += [100, 200, 300]
        memory += [9_000_000, 1_000_000, 1_000_000]

    monkeypatch.setattr(soak_memory, "soak", pretend)
    arguments = ["--warm-up", "150", "--json", "a.json", "--figure", "a.png"]
    monkeypatch.setattr(sys, "argv", ["soak_memory.py", *arguments])
    monkeypatch.chdir(tmp_path)
    soak_memory.main()
    assert json.loads((tmp_path / "a.json").read_text())["bytes"] == [9 * 10**6, 10**6, 10**6]
    assert (tmp_path / "a.png").stat().st_size > 1000
    assert "slope_kb_per_1000_frames: 0.0" in capsys.readouterr().out.replace("-0.0", "0.0")
