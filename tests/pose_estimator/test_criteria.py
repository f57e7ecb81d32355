"""What must be and what is, from records made by hand."""

import pytest
from two_view_pose.pose_estimator.criteria import criteria


def record(metric, value, low=None, high=None, **tags):
    return {
        "metric": metric, "value": value, "unit": "", "method": "mid", "gap": 10,
        "low": value if low is None else low, "high": value if high is None else high, **tags,
    }  # fmt: skip


def passing() -> list[dict]:
    """Records with which every bar is met."""
    distance = {"scene": "linemod", "object": "mean"}
    return [
        record("keypoint_distance", 0.0099, **distance, gap="mean"),
        record("keypoint_distance", 0.0049, **distance),
        record("add_s_recall", 0.976, scene="linemod", object="mean"),
        record("add_s_recall", 0.76, scene="occlusion", object="mean"),
        record("add_s_recall_difference", 0.01, scene="occlusion", against="rgbd"),
        record("solver_recall_difference", 0.01, scene="occlusion", against="kabsch"),
        *(
            record("keypoint_distance_difference", -0.001, scene="linemod", against=o, gap=g)
            for o in ("early", "late")
            for g in (1, 5, 10)
        ),
        record("training_add_s_recall_difference", 0.02, scene="linemod", training="no pose loss"),
    ]


def changed(index: int, **values) -> list[dict]:
    records = passing()
    records[index] |= values
    return records


def test_all_met():
    assert [c.verdict for c in criteria(passing())] == ["met"] * 8


def test_nothing_measured():
    assert [c.verdict for c in criteria([])] == ["not measured"] * 8
    assert criteria([])[0].found == ""


@pytest.mark.parametrize(
    ("place", "index", "value", "low", "high", "verdict"),
    [
        (0, 0, 0.0101, 0.0101, 0.0110, "short"),
        (0, 0, 0.0101, 0.0090, 0.0110, "short, unsure"),
        (0, 0, 0.0100, 0.0090, 0.0110, "met, unsure"),
        (1, 1, 0.0051, 0.0051, 0.0060, "short"),
        (3, 2, 0.974, 0.960, 0.974, "short"),
        (3, 2, 0.975, 0.975, 0.980, "met"),
        (4, 3, 0.70, 0.60, 0.80, "short, unsure"),
        (5, 4, -0.01, -0.02, -0.001, "short"),
        (5, 4, 0.01, -0.02, 0.03, "met, unsure"),
        (6, 5, 0.0, 0.0, 0.0, "short"),
        (6, 5, 0.01, -0.01, 0.03, "met, unsure"),
    ],
)
def test_bars(place, index, value, low, high, verdict):
    found = criteria(changed(index, value=value, low=low, high=high))
    assert found[place].verdict == verdict
    assert sum(c.verdict != "met" for c in found) == (verdict != "met")


def test_figures_are_shown_with_their_intervals():
    found = criteria(changed(0, value=0.01234, low=0.0111, high=0.0135))[0]
    assert found.found == "12.3 mm (11.1 to 13.5)" and found.bar == "at most 10 mm"
    gain = criteria(changed(4, value=0.024, low=-0.001, high=0.05))[5]
    assert gain.found == "+2.4 points (-0.1 to +5.0)" and gain.bar == "above 0"
    assert criteria(passing())[3].bar == "at least 97.5 %"


def test_without_an_interval_nothing_is_sure():
    records = passing()
    del records[0]["low"], records[0]["high"]
    assert criteria(records)[0].verdict == "met, unsure"
    assert criteria(records)[0].found == "9.9 mm"
    del records[9]["low"], records[9]["high"]
    assert criteria(records)[2].verdict == "met, unsure"


def test_who_is_nearer_is_named():
    found = criteria(changed(9, value=0.0021, low=0.001, high=0.003))[2]
    assert found.verdict == "short" and found.found == "no: late is 2.1 mm nearer at gap 1"
    assert criteria(changed(9, value=0.0021, low=-0.001, high=0.003))[2].verdict == "short, unsure"
    # A comparison that was not made cannot be won.
    assert criteria(passing()[:11])[2].verdict == "not measured"
    assert criteria(passing()[:11])[2].found == ""
