"""The paper's claims: what counts as confirmed, and what as contradicted."""

import pytest
from two_view_pose.pose_estimator.study.claims import (
    CLAIMS,
    CONFIRMED,
    CONTRADICTED,
    PARTLY,
    UNTESTED,
    findings,
)

MORE_ACCURATE = "Mid-Fusion has the most accurate keypoints of the three at every gap."


def distances(early, late, mid) -> list[dict]:
    """The means of three gaps, m."""
    return [
        {"metric": "keypoint_distance", "scene": "linemod", "object": "mean", "method": method,
         "gap": gap, "value": value, "low": value, "high": value}
        for method, values in (("early", early), ("late", late), ("mid", mid))
        for gap, value in zip((1, 5, 10), values, strict=True)
    ]  # fmt: skip


def differences(values, width=0.001, method="mid", others=("early", "late")) -> list[dict]:
    return [
        {"metric": "keypoint_distance_difference", "scene": "linemod", "method": method,
         "against": other, "gap": gap, "value": v, "low": v - width, "high": v + width}
        for other in others for gap, v in zip((1, 5, 10), values, strict=True)
    ]  # fmt: skip


def found(records, text: str):
    return {claim.text: finding for claim, finding in findings(records)}[text]


def test_every_claim_is_listed_also_without_results():
    assert [claim for claim, _ in findings([])] == list(CLAIMS)
    assert {finding.verdict for _, finding in findings([])} == {UNTESTED}


@pytest.mark.parametrize(
    ("values", "width", "verdict"),
    [
        ((-0.02, -0.01, -0.004), 0.001, CONFIRMED),
        ((-0.02, -0.01, -0.004), 0.005, PARTLY),  # undecided at gap 10
        ((0.02, 0.01, 0.004), 0.001, CONTRADICTED),
        ((0.02, -0.01, -0.004), 0.001, PARTLY),
        ((0.001, 0.001, 0.001), 0.002, PARTLY),  # nothing is significant
    ],
)
def test_a_claim_about_all_gaps(values, width, verdict):
    finding = found(differences(values, width), MORE_ACCURATE)
    assert finding.verdict == verdict
    assert f"{1000 * values[0]:+.1f} / {1000 * values[1]:+.1f}" in finding.figures


def test_without_an_interval_nothing_is_claimed():
    few = differences((-0.02, -0.01, -0.004)) + distances((3, 2, 1), (3, 2, 1), (3, 2, 1))
    few = [{k: v for k, v in record.items() if k not in ("low", "high")} for record in few]
    for text in (MORE_ACCURATE, CLAIMS[0].text):
        assert found(few, text).verdict == UNTESTED
        assert "too few sequences" in found(few, text).figures


def test_improving_with_the_gap():
    text = CLAIMS[0].text
    better, worse = (0.03, 0.02, 0.01), (0.01, 0.02, 0.03)
    assert found(distances(better, better, better), text).verdict == CONFIRMED
    assert found(distances(better, better, worse), text).verdict == PARTLY
    assert found(distances(worse, worse, worse), text).verdict == CONTRADICTED


@pytest.mark.parametrize(
    ("value", "verdict"), [(0.2, CONFIRMED), (0.0, PARTLY), (-0.2, CONTRADICTED)]
)
def test_two_views_against_one(value, verdict):
    gain = {"metric": "add_s_recall_difference", "scene": "occlusion", "method": "mid",
            "against": "single", "gap": 10, "value": value, "low": value - 0.1,
            "high": value + 0.1}  # fmt: skip
    finding = found([gain], "Also under occlusion.")
    assert finding.verdict == verdict and f"{100 * value:+.1f} points" in finding.figures


@pytest.mark.parametrize(("mid", "verdict"), [(0.9, CONFIRMED), (0.1, CONTRADICTED)])
def test_most_keypoints_at_most_distances(mid, verdict):
    shares = {"early": 0.5, "late": 0.6, "mid": mid}
    records = [
        {"metric": "keypoint_recall", "scene": "linemod", "object": "mean", "method": method,
         "baseline": baseline, "value": 0.8 if baseline > 0.2 else share, "low": 0, "high": 1}
        for method, share in shares.items() for baseline in (0.0125, 0.1125, 0.1625, 0.2125)
    ]  # fmt: skip
    finding = found(records, CLAIMS[4].text)
    assert finding.verdict == verdict
    assert "below 10 cm" in finding.figures and "of 4 bins" in finding.figures
