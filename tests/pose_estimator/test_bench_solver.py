"""The benchmark's problems are what they say, and its records can be written."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from two_view_pose.pose_estimator import bench_solver
from two_view_pose.pose_estimator.bench_solver import (
    affine_poses,
    compare_robustness,
    compare_speed,
    draw_problems,
    share_of_right_poses,
    soft_ransac_poses,
)
from two_view_pose.pose_estimator.results import check_record
from two_view_pose.pose_estimator.stopwatch import Missing


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
    assert share_of_right_poses(problems, poses) == 1.0
    squares = poses[:, :, :3] @ poses[:, :, :3].transpose(0, 2, 1)
    np.testing.assert_allclose(squares, np.tile(np.eye(3), (20, 1, 1)), atol=1e-5)
    poses[:5, 0, 3] += 0.15 * problems.diameter
    poses[5:8] = np.nan
    assert share_of_right_poses(problems, poses) == 0.6


def test_records(monkeypatch):
    missing = Missing("Open3D", "not here", bench_solver.OPEN3D_HINT)
    monkeypatch.setattr(bench_solver, "in_own_process", lambda *_: missing)
    *speeds, last = compare_speed(repeats=1, seed=0)
    assert last is missing and "pip install open3d" in str(last)
    for speed in map(check_record, speeds):
        assert speed["metric"] == "ratio" and speed["goal"] == 1.0 and speed["value"] > 0
    assert [(s["against"][4:], s["outliers"]) for s in speeds] == [
        ("solvePnPRansac", 0),
        ("estimateAffine3D", 0),
        ("estimateAffine3D, made a pose", 0),
        ("solvePnPRansac", 3),
        ("estimateAffine3D", 3),
        ("estimateAffine3D, made a pose", 3),
    ]
    robust = check_record(compare_robustness(seed=0, count=60))
    assert robust["goal"] == 1.0 and 0 <= robust["share_against"] <= robust["share"] <= 1
    assert robust["value"] == pytest.approx(robust["share"] / robust["share_against"])


def test_without_open3d_the_reason_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    found = bench_solver.compare_with_open3d(repeats=1, seed=0)
    assert isinstance(found, Missing) and found.against == "Open3D"
