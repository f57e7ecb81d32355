"""What the paper published: figures on real photographs, shown beside ours and never mixed in.

"Towards Two-view 6D Object Pose Estimation: A Comparative Study on Fusion Strategy", arXiv
2207.00260. Its tests are the real LineMOD and Occlusion LineMOD; ours are simulated scenes with
objects of our own making, so a difference between a column of theirs and one of ours is no
comparison of methods.

Only figures that we have from the paper stand here. A figure that we do not have stays empty.
"""

from __future__ import annotations

from dataclasses import dataclass

PAPER = "arXiv 2207.00260"
TITLE = "Towards Two-view 6D Object Pose Estimation: A Comparative Study on Fusion Strategy"


@dataclass(frozen=True)
class PublishedFigure:
    """One number of the paper.

    Attributes:
        metric: ``keypoint_distance`` (m), ``add_s_recall`` (0 to 1) or ``add_s_recall_difference``.
        value: the number.
        method: whose it is, in our names: ``mid`` is the paper's Mid-Fusion.
        scene: ``linemod`` or ``occlusion``; in the paper these are the real data sets.
        object: a name, or ``mean``.
        gap: frames between the two views, ``mean`` over the gaps, or None where it does not matter.
        against: the other method of a difference.
    """

    metric: str
    value: float
    method: str
    scene: str
    object: str = "mean"
    gap: int | str | None = None
    against: str | None = None


FIGURES = (
    PublishedFigure("keypoint_distance", 0.013, "mid", "linemod", gap="mean"),
    PublishedFigure("keypoint_distance", 0.007, "mid", "linemod", gap=10),
    PublishedFigure("add_s_recall", 0.975, "mid", "linemod", gap=10),
    PublishedFigure("add_s_recall", 0.666, "mid", "occlusion", gap=10),
    PublishedFigure(
        "add_s_recall_difference", 0.024, "mid", "occlusion", gap=10, against="rgbd"
    ),
)  # fmt: skip


def published(
    metric: str,
    method: str,
    scene: str,
    *,
    object_name: str = "mean",
    gap: int | str | None = None,
    against: str | None = None,
) -> float | None:
    """A figure of the paper, or None where we do not have it."""
    for figure in FIGURES:
        key = (figure.metric, figure.method, figure.scene, figure.object, figure.gap)
        if key == (metric, method, scene, object_name, gap) and figure.against == against:
            return figure.value
    return None
