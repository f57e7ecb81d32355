"""Records of results files."""

import json
from pathlib import Path

import numpy as np
import pytest
from two_view_pose.core.errors import InputError
from two_view_pose.core.results import check_record, read_results


def test_invalid_records_are_rejected(tmp_path: Path) -> None:
    good = {"metric": "ratio", "value": np.float32(0.5), "unit": "1", "n": np.int64(3)}
    assert (
        json.dumps(check_record(good)) == '{"metric": "ratio", "value": 0.5, "unit": "1", "n": 3}'
    )
    for change, message in (
        ({"value": float("nan")}, "value must be finite"),
        ({"value": True}, "value must be .*int, float, got True"),
        ({"unit": None}, "unit must be .*str, got None"),
        ({"tag": [1, 2]}, "tag must be"),
    ):
        with pytest.raises(ValueError, match=message):
            check_record({**good, **change})
    with pytest.raises(ValueError, match=r"value must be .*got None"):
        check_record({"metric": "ratio"})
    (tmp_path / "x.json").write_text("[]")
    with pytest.raises(ValueError, match="must have the keys"):
        read_results(tmp_path / "x.json")


@pytest.mark.parametrize(
    "change",
    [
        {"command": 3}, {"versions": []}, {"seed": "0"}, {"records": 3}, {"records": [3]},
        {"records": [{"metric": "ratio", "value": None, "unit": "1"}]},
        {"records": [{"metric": "ratio", "value": 10**400, "unit": "1"}]},
    ],
)  # fmt: skip
def test_damaged_results_are_refused_by_name(tmp_path: Path, change: dict) -> None:
    path = tmp_path / "results.json"
    good = {"command": "evaluate", "versions": {}, "seed": None, "records": []}
    path.write_text(json.dumps(good))
    assert read_results(path) == good
    path.write_text(json.dumps(good | change))
    with pytest.raises(InputError, match=r"results\.json"):
        read_results(path)
    path.write_text("[" * 100_000)
    with pytest.raises(InputError, match=r"results\.json is not JSON"):
        read_results(path)
