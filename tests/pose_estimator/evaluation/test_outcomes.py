"""Results that summarize outcomes, against hand-computed values."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.study_cases import only_record
from scipy.stats import binomtest
from two_view_pose.pose_estimator.evaluation.outcomes import Outcome, print_table, summarize


def outcome(name: str, error: float, seconds: float = 0.1) -> Outcome:
    return Outcome(name, error, error / 10, seconds, 30.0, 1.0, 0.9)


def test_summarize_averages_over_objects_not_over_pairs():
    outcomes = [outcome("a", e) for e in (0.05, 0.15, 0.099, 3.0)] + [outcome("b", 0.01, 0.5)]
    records = summarize(outcomes, {"method": "mid", "scene": "linemod"})
    a, b, mean = (only_record(records, "add_s_recall", object=name) for name in ("a", "b", "mean"))
    assert (a["value"], b["value"], mean["value"]) == (0.5, 1.0, 0.75)
    assert (a["n"], b["n"], mean["n"]) == (4, 1, 5)
    expected = np.mean([0.05, 0.15, 0.099, 1.0])  # errors are capped at a diameter
    assert only_record(records, "add_over_diameter", object="a")["value"] == pytest.approx(expected)
    assert only_record(records, "keypoint_distance", object="b")["unit"] == "m"
    (seconds,) = [r for r in records if r["metric"] == "seconds_per_pair"]
    assert seconds["value"] == 0.1 and seconds["unit"] == "s"
    assert all(r["method"] == "mid" and r["scene"] == "linemod" for r in records)
    assert all(r["low"] <= r["value"] <= r["high"] for r in records if "low" in r)


def test_the_interval_of_the_mean_is_about_the_mean():
    # Many easy pairs of one object, few hard ones of another: the mean is over the objects.
    outcomes = [outcome("a", 0.01)] * 200 + [outcome("b", 0.5)] * 5
    mean = only_record(summarize(outcomes, {}), "add_s_recall", object="mean")
    assert mean["value"] == 0.5
    assert mean["low"] <= 0.5 <= mean["high"]


def test_a_few_pairs_of_objects_that_are_always_or_never_right_are_uncertain():
    outcomes = [outcome(name, 0.01) for name in "aaaaabbbbb"] + [outcome("c", 2.0)] * 4
    records = summarize(outcomes, {})
    mean = only_record(records, "add_s_recall", object="mean")
    assert mean["value"] == pytest.approx(2 / 3) and mean["high"] - mean["low"] > 0.2
    never = only_record(records, "add_s_recall", object="c")
    wilson = binomtest(0, 4).proportion_ci(method="wilson")
    assert (never["low"], never["high"]) == pytest.approx((wilson.low, wilson.high))
    assert "low" not in only_record(records, "keypoint_distance", object="c")


def test_pairs_of_one_scene_are_not_independent():
    pairs = [replace(outcome("a", 0.01 if s < 8 else 1.0), scene_id=s) for s in range(10)]
    once, often = summarize(pairs, {}), summarize(pairs * 20, {})
    for metric in ("add_s_recall", "keypoint_distance"):
        wide, same = (only_record(r, metric, object="mean") for r in (once, often))
        assert same["high"] - same["low"] == pytest.approx(wide["high"] - wide["low"], rel=0.15)


def test_nothing_to_evaluate_is_an_error():
    with pytest.raises(ValueError, match="no pair of views"):
        summarize([], {})


def test_the_table_names_every_object(capsys):
    print_table(summarize([outcome("cat", 0.01), outcome("duck", 0.4)], {}), "title")
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("cat", "duck", "mean", "100.0 %", "50.0 %"))
