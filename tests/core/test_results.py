"""Records of results files."""

import json
from pathlib import Path

import numpy as np
import pytest
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
