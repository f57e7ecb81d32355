"""What the paper published: results on real photographs, shown beside ours and never mixed in.

"Towards Two-view 6D Object Pose Estimation: A Comparative Study on Fusion Strategy", arXiv
2207.00260. Its tests are the real LineMOD and Occlusion LineMOD; ours are simulated scenes with
objects of our own making, so a difference between a column of theirs and one of ours is no
comparison of methods.
"""

from __future__ import annotations

PAPER = "arXiv 2207.00260"
TITLE = "Towards Two-view 6D Object Pose Estimation: A Comparative Study on Fusion Strategy"

TESTS = {"linemod": "real LineMOD", "occlusion": "real Occlusion LineMOD"}
"""The paper's tests, by ours that resemble them."""

RESULTS: dict[tuple[str, str, int | str], float] = {
    ("keypoint_distance", "linemod", "mean"): 0.013,
    ("keypoint_distance", "linemod", 10): 0.007,
    ("add_s_recall", "linemod", 10): 0.975,
    ("add_s_recall", "occlusion", 10): 0.666,
    ("add_s_recall_difference", "occlusion", 10): 0.024,
}
"""Mid-Fusion's results by metric, test and gap (frames, or the mean over the gaps), in meters or 0
to 1; means over the objects. The difference is the gain over the RGB-D reference. Results by object
are not in the sources that these are from."""
