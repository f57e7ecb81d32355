"""BOP result files: format, round trip, and errors that name file and line."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import make_transform
from two_view_pose.pose_estimator.bop.results import (
    BopResult,
    most_confident_per_target,
    read_bop_results,
    write_bop_results,
)

HEADER = "scene_id,im_id,obj_id,score,R,t,time"
GOOD = "3,7,5,0.75,1 0 0 0 1 0 0 0 1,10 -20.5 800,0.125"


def some_results(count: int) -> list[BopResult]:
    rng = np.random.default_rng(count)
    return [
        BopResult(
            scene_id=int(rng.integers(50)),
            image_id=i,
            obj_id=int(rng.integers(1, 30)),
            score=float(rng.normal()),
            T_cam_obj=make_transform(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)),
            seconds=float(rng.uniform()),
        )
        for i in range(count)
    ]


def written(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def test_csv_has_bop_columns_and_millimeters(tmp_path):
    results = some_results(5)
    write_bop_results(tmp_path / "mid_lmo-test.csv", results)
    with (tmp_path / "mid_lmo-test.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == HEADER.split(",") and len(rows) == 5
    for row, result in zip(rows, results, strict=True):
        numbers = [int(row[name]) for name in ("scene_id", "im_id", "obj_id")]
        assert numbers == [result.scene_id, result.image_id, result.obj_id]
        assert float(row["score"]) == result.score and float(row["time"]) == result.seconds
        R = [float(number) for number in row["R"].split(" ")]
        assert result.T_cam_obj[:3, :3].ravel().tolist() == R
        t = np.array([float(number) for number in row["t"].split(" ")])
        np.testing.assert_allclose(t, 1000 * result.T_cam_obj[:3, 3], rtol=1e-15)


def test_results_round_trip(tmp_path):
    results = some_results(20)
    write_bop_results(tmp_path / "a.csv", results)
    for result, again in zip(results, read_bop_results(tmp_path / "a.csv"), strict=True):
        assert result.target == again.target
        assert (result.score, result.seconds) == (again.score, again.seconds)
        np.testing.assert_allclose(again.T_cam_obj, result.T_cam_obj, atol=1e-14)


def test_header_is_optional_and_rotations_may_be_rounded(tmp_path):
    # Without a header, with Windows' line ends, few digits and an unknown time.
    R = Rotation.from_euler("xyz", [0.3, -1, 2]).as_matrix()
    few = " ".join(f"{number:.4f}" for number in R.ravel())
    path = tmp_path / "a.csv"
    path.write_bytes(f"1,2,3,1,{few},1.0 2.0 3e2,-1\r\n{GOOD}\r\n\r\n".encode())
    first, second = read_bop_results(path)
    assert first.target == (1, 2, 3) and first.seconds == -1 and second.target == (3, 7, 5)
    np.testing.assert_allclose(first.T_cam_obj[:3, :3], R, atol=1e-4)
    rotation = first.T_cam_obj[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(second.T_cam_obj[:3, 3], [0.01, -0.0205, 0.8])
    assert read_bop_results(written(tmp_path / "none.csv", HEADER)) == ()


@pytest.mark.parametrize(
    ("row", "complaint"),
    [
        (GOOD.rsplit(",", 1)[0], r"must have 7 columns .*got 6"),
        (GOOD.replace("10 -20.5 800", "10,-20.5,800"), r"must have 7 columns .*separated by"),
        (GOOD.replace("800", "nan"), r"field 't' is NaN, infinite"),
        (GOOD.replace("10 -20.5", "10"), r"field 't' must be 3 numbers"),
        (GOOD.replace("1 0 0 0 1", "1 0 0 0 x"), r"field 'R' must be 9 numbers"),
        (GOOD.replace("1 0 0 0 1 0", "2 0 0 0 1 0"), r"field 'R' is not rigid"),
        (GOOD.replace("1 0 0 0 1 0", "-1 0 0 0 1 0"), r"determinant -1"),
        (GOOD.replace("0.75", "inf"), r"field 'score' is NaN, infinite"),
        (GOOD.replace("0.125", ""), r"field 'time' must be a number"),
        (GOOD.replace("3,7,5", "3,7.5,5"), r"im_id: expected an integer >= 0, got '7\.5'"),
        (GOOD.replace("3,7,5", "4,7,5"), r"scene_id 4 is not in the dataset.* has 3"),
        (GOOD.replace("3,7,5", "3,9,5"), r"im_id 9 is not in the dataset.* has 6, 7"),
        (GOOD.replace("3,7,5", "3,7,8"), r"obj_id 8 is not in the dataset.* has 5, 6"),
    ],
)
def test_invalid_rows_are_reported_with_file_and_line(tmp_path, row, complaint):
    path = written(tmp_path / "a.csv", HEADER, GOOD, row)
    with pytest.raises(ValueError, match=rf"a\.csv, line 3: .*{complaint}"):
        read_bop_results(path, {3: {6, 7}}, {5, 6})
    assert len(read_bop_results(written(path, HEADER, GOOD), {3: {6, 7}}, {5, 6})) == 1


def test_missing_binary_and_empty_files_are_rejected(tmp_path):
    with pytest.raises(ValueError, match=r"cannot read .*nothing\.csv"):
        read_bop_results(tmp_path / "nothing.csv")
    with pytest.raises(ValueError, match="cannot read"):
        read_bop_results(tmp_path)
    (tmp_path / "image.csv").write_bytes(b"\x89PNG\r\n\xff\xfe")
    with pytest.raises(ValueError, match="not a text file"):
        read_bop_results(tmp_path / "image.csv")
    with pytest.raises(ValueError, match="is empty"):
        read_bop_results(written(tmp_path / "empty.csv", ""))


def test_writing_rejects_non_finite_values(tmp_path):
    (good,) = some_results(1)
    bad = good.T_cam_obj.copy()
    bad[0, 3] = np.nan
    with pytest.raises(ValueError, match=f"object {good.obj_id} in scene .*NaN"):
        write_bop_results(tmp_path / "a.csv", [replace(good, T_cam_obj=bad)])
    with pytest.raises(ValueError, match="must be finite"):
        write_bop_results(tmp_path / "a.csv", [replace(good, score=np.inf)])
    assert not (tmp_path / "a.csv").exists()


def test_lowest_uncertainty_is_kept_and_times_are_per_image():
    template = replace(some_results(1)[0], scene_id=1, image_id=2, obj_id=5, seconds=0.25)
    answers = [
        (replace(template, score=0.1), 0.002),
        (replace(template, score=0.2), 0.001),
        (replace(template, obj_id=9, seconds=0.5), 0.1),
        (replace(template, score=0.3), 0.001),
        (replace(template, image_id=3), 0.5),
    ]
    given = most_confident_per_target(answers)
    assert [result.target for result in given] == [(1, 2, 5), (1, 2, 9), (1, 3, 5)]
    assert given[0].score == 0.2
    assert [result.seconds for result in given] == [0.75, 0.75, 0.25]
