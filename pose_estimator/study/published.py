"""Results that the paper published, on real images; the report shows them in their own column.

The paper's tests are real images of LineMOD; ours are simulated scenes with our own objects, so a
difference between a published and a measured result does not compare methods.
"""

PAPER = "arXiv 2207.00260"
TITLE = "Towards Two-view 6D Object Pose Estimation: A Comparative Study on Fusion Strategy"

TESTS = {"linemod": "real LineMOD", "occlusion": "real Occlusion LineMOD"}
"""The paper's tests, by our corresponding ones."""

RESULTS: dict[tuple[str, str, int | str], float] = {
    ("keypoint_distance", "linemod", "mean"): 0.013,
    ("keypoint_distance", "linemod", 10): 0.007,
    ("add_s_recall", "linemod", 10): 0.975,
    ("add_s_recall", "occlusion", 10): 0.666,
    ("add_s_recall_difference", "occlusion", 10): 0.024,
}
"""Mid-Fusion's results by metric, test and gap (frames, or the mean over the gaps), in meters or 0
to 1; means over the objects. The difference is the gain over the RGB-D reference."""

NO_RESULTS_BY_OBJECT = (
    "Of the paper only the mean stands here: its results by object are not in the sources that "
    "this page is made from."
)
