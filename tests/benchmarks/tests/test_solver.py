"""The benchmark's problems are what they say, and its records can be written."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from benchmarks.groups.solver import (
    affine_poses,
    compare_robustness,
    compare_with_open3d,
    draw_problems,
    share_of_correct_poses,
    soft_ransac_poses,
)
from two_view_pose.core.results import check_record


@pytest.mark.parametrize("outliers", [0, 3])
def test_problems_have_so_many_outliers(outliers):
    problems = draw_problems(np.random.default_rng(0), 50, deviation=0.001, outliers=outliers)
    off = np.linalg.norm(problems.predicted - problems.true, axis=-1)
    assert ((off > 0.01).sum(axis=1) <= outliers).all()
    assert (off > 0.01).sum(axis=1).mean() >= 0.95 * outliers
    assert np.ptp(problems.true[..., 2]) < 1 and problems.true[..., 2].min() > 0.5


@pytest.mark.parametrize("poses_of", [soft_ransac_poses, affine_poses])
def test_both_solve_easy_problems(poses_of):
    problems = draw_problems(np.random.default_rng(1), 20, deviation=0.0005)
    poses = poses_of(problems)
    assert share_of_correct_poses(problems, poses) == 1.0
    squares = poses[:, :, :3] @ poses[:, :, :3].transpose(0, 2, 1)
    np.testing.assert_allclose(squares, np.tile(np.eye(3), (20, 1, 1)), atol=1e-5)
    poses[:5, 0, 3] += 0.15 * problems.diameter
    poses[5:8] = np.nan
    assert share_of_correct_poses(problems, poses) == 0.6


def test_robustness_is_a_ratio_of_shares():
    record = check_record(compare_robustness(seed=0, count=60))
    assert 0 <= record["share_against"] <= record["share"] <= 1
    assert record["value"] == pytest.approx(record["share"] / record["share_against"])


def test_without_open3d_the_reason_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    (record,) = map(check_record, compare_with_open3d(repeats=1, seed=0))
    assert record["metric"] == "missing" and "pip install open3d" in record["install"]
