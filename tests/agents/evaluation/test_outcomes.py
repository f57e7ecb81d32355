"""Statistics of an evaluation, checked by hand, and paired comparisons."""

from __future__ import annotations

import numpy as np
import pytest
from two_view_pose.agents.evaluation.outcomes import (
    Outcome,
    display_name,
    gap_closed,
    make_records,
    print_table,
)


def outcomes(errors: list[float], visibility: float = 0.5) -> list[Outcome]:
    names = ("cat", "duck")
    return [Outcome(names[i % 2], e, 0.3, visibility) for i, e in enumerate(errors)]


def find(records: list[dict], **tags: object) -> dict:
    [record] = [r for r in records if all(r.get(k) == v for k, v in tags.items())]
    return record


def test_gap_closed() -> None:
    rule, oracle = np.array([0.4, 0.6, 0.5] * 4), np.full(12, 0.1)
    for share in (0.0, 0.5, 1.0, -0.3):
        policy = rule + share * (oracle - rule)
        value, low, high = gap_closed(policy, rule, oracle)
        assert (value, low, high) == pytest.approx((share,) * 3)
    assert gap_closed(rule, oracle, oracle) is None
    value, low, high = gap_closed(np.array([0.1, 0.6, 0.5] * 4), rule, oracle)
    assert low < value < high and value == pytest.approx(0.25)
    assert gap_closed(rule[:5], rule[:5], oracle[:5]) == (0.0, None, None)


def test_paired_difference_intervals() -> None:
    rng = np.random.default_rng(0)
    hard = rng.uniform(0.0, 0.9, 200)  # scenes differ far more than the policies do
    records = make_records(
        {
            "stay": outcomes((hard + 0.05).tolist()),
            "max-baseline": outcomes(hard.tolist()),
            "mine": outcomes((hard - 0.01 + rng.normal(0, 0.001, 200)).tolist()),
            "oracle": outcomes((hard - 0.05).tolist()),
        },
        "occlusion",
    )
    found = find(records, policy="mine", metric="capped_difference")
    assert found["low"] < found["value"] < found["high"] < 0
    assert found["value"] == pytest.approx(-0.01, abs=0.001)
    alone = find(
        records, policy="mine", metric="capped_add_over_diameter", object="mean", visibility=None
    )
    assert alone["high"] - alone["low"] > 20 * (found["high"] - found["low"])
    assert find(records, policy="mine", metric="gap_closed")["value"] == pytest.approx(
        0.2, abs=0.02
    )
    assert find(records, policy="oracle", metric="regret")["value"] == 0.0
    assert find(records, policy="max-baseline", metric="gap_closed")["value"] == 0.0


def test_repeated_scenes_do_not_narrow_intervals() -> None:
    errors = (0.05, 0.2, 0.6, 0.08, 0.03, 1.2, 0.9)
    rows = [Outcome("cat", e, 0.1 * e, 0.5, scene=i) for i, e in enumerate(errors)]
    once = make_records({"random": rows}, "heap")
    twice = make_records({"random": rows + rows}, "heap")
    for metric in ("add_s_recall", "capped_add_over_diameter", "travel"):
        tags = {"metric": metric, "object": "mean", "visibility": None}
        assert find(twice, **tags) == pytest.approx(find(once, **tags))
        assert find(twice, **tags)["n"] == 7 and "low" in find(twice, **tags)


@pytest.mark.parametrize("errors", [[0.01, 0.02] * 3, [5.0] * 14, [0.01] * 13 + [3.0]])
def test_intervals_stay_within_what_is_possible(errors: list[float]) -> None:
    rows = [Outcome("cat", e, float(e > 1), scene=i) for i, e in enumerate(errors)]
    records = make_records({"stay": rows, "max-baseline": rows, "oracle": rows}, "heap")
    largest = {"add_over_diameter": 5.0}
    for record in records:
        low, high = record["low"], record["high"]
        smallest = -1 if "against" in record else 0
        assert smallest <= low <= record["value"] <= high <= largest.get(record["metric"], 1)
    recall = find(records, metric="add_s_recall", policy="stay", object="mean")
    assert recall["high"] - recall["low"] > 0.2
    of_itself = find(records, metric="add_s_recall_difference", policy="max-baseline")
    assert of_itself["low"] == of_itself["high"] == 0.0


def test_few_scenes_are_said(capsys: pytest.CaptureFixture[str]) -> None:
    few = {"stay": outcomes([0.05, 0.2])}
    records = make_records(few, "heap")
    assert "low" not in find(records, metric="travel", object="mean", visibility=None)
    assert find(records, metric="add_s_recall", object="mean", visibility=None)["low"] > 0
    print_table(few, "scenes")
    assert "0.125 (too few)" in capsys.readouterr().out


def test_visibility_bins() -> None:
    rows = outcomes([0.05, 0.2], 0.3) + outcomes([0.05, 0.05, 0.3], 1.0)
    records = make_records({"stay": rows}, "heap")
    low = find(records, metric="add_s_recall", visibility=0.0)
    assert (low["value"], low["n"]) == (0.5, 2)
    high = find(records, metric="add_s_recall", visibility=0.9)
    assert (high["value"], high["n"]) == (pytest.approx(2 / 3), 3)
    assert not [r for r in records if r.get("visibility") == 0.4]
    assert not [r for r in records if "against" in r]


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611)],
)
def test_wilson_interval_of_recall(successes: int, n: int, low: float, high: float) -> None:
    """Newcombe, "Two-sided confidence intervals for the single proportion", 1998, table I."""
    rows = outcomes([0.05] * successes + [0.5] * (n - successes))
    found = find(
        make_records({"stay": rows}, "heap"), metric="add_s_recall", object="mean", visibility=None
    )
    assert (found["low"], found["high"]) == pytest.approx((low, high), abs=5e-5)
    assert found["value"] == successes / n


def test_capped_error() -> None:
    records = make_records({"stay": outcomes([0.0, 7.0])}, "heap")
    capped = find(records, metric="capped_add_over_diameter", object="mean", visibility=None)
    assert capped["value"] == 0.5
    plain = find(records, metric="add_over_diameter", object="mean", visibility=None)
    assert plain["value"] == 3.5


def test_display_name_of_a_file_is_its_folder() -> None:
    assert display_name("runs/ppo-1/policy.safetensors") == "ppo-1"
    assert display_name("max-baseline") == "max-baseline"


@pytest.mark.parametrize("names", [("max-baseline", "oracle"), ("random", "runs/ppo/policy")])
def test_table_fits_80_columns(
    names: tuple[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    views = 1 if "oracle" in names else 3
    errors = np.linspace(0.0, 1.0, 1000)
    rows = [Outcome("cat", e, 1.2, 0.5, views=views, scene=i) for i, e in enumerate(errors)]
    print_table(dict.fromkeys(names, rows), "scenes")
    table = [line for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert len(table) == 3 + len(names) and max(map(len, table)) <= 80
    for name, line in zip(names, table[3:], strict=True):
        assert line.split()[0] == name and "10.0 (8-12) %" in line and "0.500 (0.482-0.518)" in line
