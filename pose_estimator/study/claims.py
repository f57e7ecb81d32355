"""The paper's claims about fusions, each with what our measurements say about it.

Its measurements are on photographs and ours on renders, so a claim is about the order of methods,
not about the numbers. "Better" is what the paper's tables show; what it argues without a
measurement is not tested.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from .plan import BEST_GAP, GAPS

Records = Sequence[Mapping[str, Any]]

CONFIRMED, PARTLY, CONTRADICTED, UNTESTED = "confirmed", "partly", "contradicted", "not tested"

FUSIONS = ("early", "late", "mid")
"""The paper's three approaches."""


@dataclass(frozen=True)
class Finding:
    """What the measurements say.

    Attributes:
        verdict: ``CONFIRMED``, ``PARTLY``, ``CONTRADICTED`` or ``UNTESTED``.
        figures: our figures, or why it is not tested.
    """

    verdict: str
    figures: str


@dataclass(frozen=True)
class Claim:
    """A claim of the paper.

    Attributes:
        text: the claim.
        source: where the paper makes it.
        check: finds out.
    """

    text: str
    source: str
    check: Callable[[Records], Finding]


_MISSING = Finding(UNTESTED, "not all of its methods were measured")
_FEW = Finding(UNTESTED, "too few sequences for an interval")


def findings(records: Records) -> list[tuple[Claim, Finding]]:
    """Returns each claim with what the records say about it."""
    return [(claim, claim.check(records)) for claim in CLAIMS]


def _verdict(agrees: Sequence[bool], opposes: Sequence[bool]) -> str:
    """Confirmed if all agree, contradicted if none does and one is significantly the opposite."""
    if all(agrees):
        return CONFIRMED
    return CONTRADICTED if any(opposes) and not any(agrees) else PARTLY


def _values(records: Records, metric: str, **tags: Any) -> dict[Any, Mapping[str, Any]]:
    """Returns the records of a metric by gap."""
    return {
        r["gap"]: r
        for r in records
        if r["metric"] == metric and all(r.get(name) == value for name, value in tags.items())
    }


def _smaller(records: Records, method: str, others: Sequence[str], gaps: Sequence[int]) -> Finding:
    """Whether a method's keypoints are nearer to the truth than others', intervals below zero."""
    agrees, opposes, texts = [], [], []
    for other in others:
        tags = {"scene": "linemod", "method": method, "against": other}
        found = _values(records, "keypoint_distance_difference", **tags)
        if not set(gaps) <= set(found):
            return _MISSING
        differences = [found[gap] for gap in gaps]
        if not all("low" in d for d in differences):
            return _FEW
        agrees += [d["high"] < 0 for d in differences]
        opposes += [d["low"] > 0 for d in differences]
        values = " / ".join(f"{1000 * d['value']:+.1f}" for d in differences)
        texts.append(f"{method} minus {other} {values} mm")
    at = " / ".join(map(str, gaps))
    return Finding(_verdict(agrees, opposes), f"{'; '.join(texts)} at gaps {at}")


def _gains(records: Records, scene: str) -> Finding:
    """Whether ``mid`` is right more often than ``single`` at the gap of the tables."""
    tags = {"scene": scene, "method": "mid", "against": "single"}
    gain = _values(records, "add_s_recall_difference", **tags).get(BEST_GAP)
    if gain is None:
        return _MISSING
    if "low" not in gain:
        return _FEW
    low, high = gain["low"], gain["high"]
    verdict, interval = _verdict([low > 0], [high < 0]), f"{100 * low:+.1f} to {100 * high:+.1f}"
    text = f"mid minus single {100 * gain['value']:+.1f} points ({interval})"
    return Finding(verdict, f"{text}, gap {BEST_GAP}; no other RGB method")


def _improves(records: Records) -> Finding:
    """Whether each fusion's keypoints are nearer at the larger gap."""
    agrees, texts = [], []
    for method in FUSIONS:
        tags = {"scene": "linemod", "method": method, "object": "mean"}
        found = _values(records, "keypoint_distance", **tags)
        if not set(GAPS) <= set(found):
            return _MISSING
        if not all("low" in found[gap] for gap in GAPS):
            return _FEW
        values = [found[gap]["value"] for gap in GAPS]
        agrees += [a > b for a, b in pairwise(values)]
        texts.append(f"{method} {' / '.join(f'{1000 * v:.1f}' for v in values)} mm")
    return Finding(_verdict(agrees, [not a for a in agrees]), "; ".join(texts))


def _best_at_distances(records: Records) -> Finding:
    """At how many distances between the cameras ``mid`` finds the largest share of keypoints."""
    shares: dict[float, dict[str, float]] = {}
    for r in records:
        wanted = r["metric"] == "keypoint_recall" and r["object"] == "mean" and "low" in r
        if wanted and r["scene"] == "linemod" and r["method"] in FUSIONS:
            shares.setdefault(r["baseline"], {})[r["method"]] = r["value"]
    whole = {b: own for b, own in shares.items() if len(own) == len(FUSIONS)}
    if not whole:
        return _MISSING
    best = [b for b, own in whole.items() if own["mid"] == max(own.values())]
    near = [b for b in whole if b < 0.1]
    text = f"mid is best in {len(best)} of {len(whole)} bins"
    if near:
        text += f", in {len([b for b in near if b in best])} of {len(near)} below 10 cm"
    verdict = CONFIRMED if 2 * len(best) > len(whole) else CONTRADICTED
    return Finding(verdict, text)


def _untested(reason: str) -> Callable[[Records], Finding]:
    return lambda records: Finding(UNTESTED, reason)


CLAIMS = (
    Claim("The keypoints of all three fusions improve with the gap.", "IV-C, Table 1", _improves),
    Claim(
        "Mid-Fusion has the most accurate keypoints of the three at every gap.", "IV-C, Table 1",
        lambda records: _smaller(records, "mid", ("early", "late"), GAPS),
    ),
    Claim(
        "Late-Fusion is second at gaps 5 and 10.", "IV-C, Table 1",
        lambda records: _smaller(records, "late", ("early",), GAPS[1:]),
    ),
    Claim(
        "Early-Fusion is the worst at every gap (the text; in Table 1 Late-Fusion is, at gap 1).",
        "IV-C",
        lambda records: _smaller(records, "late", ("early",), GAPS),
    ),
    Claim(
        "Mid-Fusion finds most keypoints at most camera distances, especially at small ones.",
        "IV-C, Figure 4", _best_at_distances,
    ),
    Claim(
        "With two views it is right more often than RGB methods of one view.", "IV-D, Table 2",
        lambda records: _gains(records, "linemod"),
    ),
    Claim(
        "Also under occlusion.", "IV-D, Table 3", lambda records: _gains(records, "occlusion")
    ),
    Claim(
        "Its keypoints are more accurate than REDE's, which have depth.", "IV-C, Table 1",
        _untested("REDE is not implemented; rgbd is a network of our own"),
    ),
    Claim(
        "Its poses are slightly better than DenseFusion's and worse than REDE's on LineMOD, and "
        "better than REDE's under occlusion.", "IV-D, Tables 2 and 3",
        _untested("neither is implemented"),
    ),
    Claim(
        "REDE's poses are better because of its solver bank.", "IV-D, argued, not measured",
        _untested("the solver bank is not implemented"),
    ),
)  # fmt: skip
"""In the order of the paper."""
