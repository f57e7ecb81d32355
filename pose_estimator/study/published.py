"""Results that the paper published, on real images; the report shows them in columns of their own.

The paper's tests are real images of LineMOD; ours are simulated scenes with our own objects, so a
difference between a published and a measured result does not compare methods.
"""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

PAPER = "arXiv 2207.00260"
TITLE = "Towards Two-view 6D Object Pose Estimation: A Comparative Study on Fusion Strategy"

TESTS = {"linemod": "real LineMOD", "occlusion": "real Occlusion LineMOD"}
"""The paper's tests, by our corresponding ones."""

FIGURE_4 = ("ape", "can", "cat", "glue", "eggbox", "iron")
"""The objects of the paper's Figure 4."""

OURS = "mid (two RGB views)"
"""The name of the paper's own method in its tables."""

_TABLES = {
    "linemod": "table2_linemod_add_s_recall_percent",
    "occlusion": "table3_occlusion_linemod_add_s_recall_percent",
}


@cache
def _content() -> Mapping[str, Any]:
    return json.loads(Path(__file__).with_name("published.json").read_text())


def keypoint_distances(gap: int | str) -> Mapping[str, float]:
    """Table 1: mean distance of the 3D keypoints by method at a gap or ``mean``, m."""
    row = "mean" if gap == "mean" else f"gap {gap}"
    return _content()["table1_keypoint_distance_m"].get(row, {})


def recalls(scene: str) -> Mapping[str, Mapping[str, float]]:
    """Tables 2 and 3: object or ``mean`` -> method -> ADD(-S) recall, percent."""
    return _content()[_TABLES[scene]]
