"""What we read, write and measure is what BOP's own toolkit does.

The figures of a run are kept, since the toolkit and what it needs are no part of this project.
Where the environment variable BOP_TOOLKIT names a checkout, the comparison is made anew.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
from pathlib import Path

import compare_with_bop_toolkit as comparison
import pytest

KEPT = Path(__file__).with_name("bop_toolkit_figures.json")
TOOLKIT = os.environ.get("BOP_TOOLKIT")

QUANTITIES = {
    "1": "annotations of a picture|object id|object to camera, rotation|world to camera, rotation|"
    "visible fraction|ids of models|number of symmetries|symmetries (each its own)|"
    "symmetries, rotation|result file written, rotation|result file written, ids, score, time|"
    "result file read, rotation|result file read, ids, score, time|targets|recall by object|"
    "recall, mean over objects",
    "px": "camera matrix|visible pixels|visible box|whole box",
    "mm": "object to camera, translation|world to camera, translation|diameter as read|"
    "bounding box as read|diameter as measured|points|symmetries, translation|ADD|ADD-S (adi)|"
    "ADD(-S) by the object|result file written, translation|"
    "result file read, translation",
    "m": "depth map (float32)|diameter written, of the mesh",
    "grey level": "picture",
}
"""Unit -> what is compared in it."""


def check(document: dict) -> None:
    """All was compared, on something that can tell, and nothing differs."""
    expected = {(name, unit) for unit, names in QUANTITIES.items() for name in names.split("|")}
    records = document["records"]
    assert {(r["quantity"], r["unit"]) for r in records} == expected
    assert len(records) == len(expected)
    for record in records:
        assert record["count"] > 0
        assert 0 <= record["largest_difference"] <= 1e-6, record
    assert document["pose_pairs_an_object"] >= 20
    assert 0.1 < document["recall_of_spoilt_poses"] < 0.9


def test_the_kept_figures_are_complete_and_differ_by_nothing():
    document = json.loads(KEPT.read_text())
    check(document)
    assert re.fullmatch(r"[0-9a-f]{40}", document["toolkit_commit"])
    assert document["data"]["objects"] == 13 and document["data"]["annotations"] >= 50
    assert {"python", "numpy", "scipy", "opencv-python-headless"} <= document["versions"].keys()
    assert document["not_compared"] == comparison.NOT_COMPARED


@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("imageio", "png")),
    reason="bop_toolkit needs imageio and pypng",
)
@pytest.mark.skipif(not TOOLKIT, reason="BOP_TOOLKIT names no checkout of bop_toolkit")
def test_nothing_differs_in_a_fresh_run(tmp_path):
    from two_view_pose.envs.generate import GenerateConfig, generate

    root = tmp_path / "set"
    generate(
        GenerateConfig(
            out=root, split="test", scenes=3, views=2, seed=7, depth=True, scene="occlusion",
            workers=1, jpeg_quality=0,
        )
    )  # fmt: skip
    check(comparison.compare(Path(str(TOOLKIT)), root))
