"""The study as one page, made from results.json and the pictures beside it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from . import METHODS
from .criteria import criteria
from .published import PAPER, TITLE
from .report_html import Cell, Row, definitions, figure, page, table
from .report_tables import (
    cost_table,
    keypoint_table,
    noise_table,
    recall_table,
    solver_table,
    training_table,
)
from .results import read_results, write_atomically
from .study_figures import draw_charts

TESTS = {"linemod": "LineMOD-style", "occlusion": "Occlusion-style"}

Records = Sequence[Mapping[str, Any]]


def write_report(folder: Path) -> Path:
    """Draws the charts and writes report.html.

    Args:
        folder: of the study; it holds results.json, and pictures in figures/.

    Returns:
        The page.

    Raises:
        ValueError: if results.json is missing or broken.
    """
    results = folder / "results.json"
    if not results.is_file():
        raise ValueError(f"{folder} holds no results.json; run compare without --report-only first")
    document = read_results(results)
    charts = draw_charts(document["records"], folder / "figures")
    pictures = sorted((folder / "figures").glob("*.png"), key=_example_number)
    target = folder / "report.html"
    write_atomically(target, report_page(document, charts, pictures).encode())
    return target


def _example_number(path: Path) -> tuple[int, str]:
    return int(path.stem.rsplit("_", 1)[-1]), path.stem


def report_page(
    document: Mapping[str, Any], charts: Mapping[str, Path], pictures: Sequence[Path]
) -> str:
    """The page of a results document, with its charts by name and its pictures."""
    records = document["records"]
    sections = [
        ("Must be, is", _criteria_section(records)),
        ("Keypoints in space", _keypoint_section(records)),
        ("Keypoints by distance", _distance_section(charts)),
        ("Poses", _pose_section(records)),
        ("Solvers", _solver_section(records)),
        ("Wrong relative poses", _noise_section(records, charts)),
        ("Training", _training_section(records)),
        ("Cost", _cost_section(records)),
        ("Pictures", "\n".join(figure(path, _caption(path, records)) for path in pictures)),
        ("How it was made", _origin_section(document)),
    ]
    return page(
        "Which fusion of two views recovers an object best?",
        [(name, content) for name, content in sections if content],
        _head(document),
    )


def _head(document: Mapping[str, Any]) -> str:
    records = document["records"]
    lines = [
        '<p class="lead">Five ways from pictures to a 6D pose, measured on the same simulated '
        "hand-held sequences: one view, three fusions of two views, and one view with a depth "
        f"sensor. After <i>{escape(TITLE)}</i> ({PAPER}).</p>",
        "<p>All our figures are on simulated scenes with objects of our own making. Figures that "
        'the paper published, on photographs, stand in <span class="paper">&nbsp;columns like '
        "this&nbsp;</span>: they say what to expect, and cannot be subtracted from ours.</p>",
        "<p>Small print under a figure is its interval of 95 percent, from a bootstrap over "
        "sequences. <b>Bold</b> is the best of a row.</p>",
    ]
    if "--quick" in document["command"]:
        lines.append(
            '<p class="notice"><b>A quick run.</b> A handful of pairs: the figures show that '
            "everything works, not how well.</p>"
        )
    missing = [r for r in records if r["metric"] == "missing"]
    if missing:
        items = "".join(f"<li>{_missing_text(r)}</li>" for r in missing)
        lines.append(f'<div class="notice"><b>Missing</b><ul>{items}</ul></div>')
    return "\n".join(lines)


def _missing_text(record: Mapping[str, Any]) -> str:
    training = f", weights with {record['training']}" if record.get("training") else ""
    scene = f" on the {TESTS[record['scene']]} test" if record.get("scene") else ""
    return f"<b>{escape(record['method'])}</b>{training}{scene}: {escape(record['reason'])}"


def _criteria_section(records: Records) -> str:
    styles = {"met": "met", "short": "short", "not measured": "none"}
    rows: list[Row] = [
        [
            c.what,
            Cell(c.paper, style="paper"),
            c.bar,
            Cell(c.found, style="text" if len(c.found) > 40 else ""),
            Cell(c.verdict, style=styles.get(c.verdict, "unsure")),
        ]
        for c in criteria(records)
    ]
    note = (
        '<p class="note">Unsure: the interval reaches to the other side of the bar, or there is '
        "none. The paper's figures are of real LineMOD and Occlusion LineMOD.</p>"
    )
    return table(["", Cell("paper", style="paper"), "must be", "is", ""], rows) + note


def _keypoint_section(records: Records) -> str:
    parts = [
        "<p>Mean distance of the nine predicted 3D keypoints from the truth, in millimetres, by "
        "the frames that lie between the two views. One gap is 1.5 to 3 cm of camera path. "
        "<code>rgbd</code> sees one view and its depth map.</p>"
    ]
    for scene, title in TESTS.items():
        content = keypoint_table(records, scene)
        if content:
            number = "Table 1: " if scene == "linemod" else ""
            parts.append(f"<h3>{number}{title} test</h3>{content}")
    return "\n".join(parts) if len(parts) > 1 else ""


def _distance_section(charts: Mapping[str, Path]) -> str:
    return "\n".join(
        figure(
            charts[f"recall_{scene}"],
            f"Figure 4, {title} test: share of keypoints nearer than 3 cm to the truth, against "
            "the distance of the camera from the object, at gap 10. Bands: 95 percent intervals.",
        )
        for scene, title in TESTS.items()
        if f"recall_{scene}" in charts
    )


def _pose_section(records: Records) -> str:
    parts = []
    for number, (scene, title) in enumerate(TESTS.items(), start=2):
        content = recall_table(records, scene)
        if content:
            parts.append(
                f"<h3>Table {number}: {title} test, share of poses with ADD(-S) below a tenth of "
                f"the diameter, percent, gap 10</h3>{content}"
            )
    return "\n".join(parts)


def _solver_section(records: Records) -> str:
    content = solver_table(records)
    if not content:
        return ""
    return (
        "<p>The same predicted keypoints, solved three ways: Soft RANSAC (the paper's average of "
        "all 84 three-point poses), least squares over all nine points (Kabsch), and RANSAC with "
        "a hard choice. Share of poses with ADD(-S) below a tenth of the diameter, percent, at "
        "gap 10; differences are taken pair by pair.</p>" + content
    )


def _noise_section(records: Records, charts: Mapping[str, Path]) -> str:
    content = noise_table(records)
    if not content:
        return ""
    parts = [
        "<p>No hand-eye calibration is exact. Here the methods are told a relative pose that is "
        "turned and shifted by so much, in a random direction (LineMOD-style test, gap 10).</p>",
        content,
    ]
    if "noise" in charts:
        parts.append(figure(charts["noise"], "The same as curves, and either error alone."))
    return "\n".join(parts)


def _training_section(records: Records) -> str:
    content = training_table(records)
    if not content:
        return ""
    return (
        "<p>Mid-Fusion with weights from other trainings, on the same pairs at gap 10. Gain: the "
        "usual weights' figure less the other's; of a distance it is good below zero.</p>" + content
    )


def _cost_section(records: Records) -> str:
    content = cost_table(records)
    if not content:
        return ""
    return (
        content + '<p class="note">Batch 1: median wall time of whole estimates, full frames in, '
        "pose out, methods in turn. Batch 16: the networks run on 16 pairs at once; what lies "
        "between them (decoding, votes, solvers) is counted as for one pair, as the estimators "
        "answer one pair at a time.</p>"
    )


def _caption(path: Path, records: Records) -> str:
    if path.stem.startswith("example"):
        return (
            "Figure 5: what each method predicts, with the mean distance of its keypoints. The "
            "pair was picked by chance."
        )
    methods = {r.get("method") for r in records if r["metric"] == "add_s_recall"}
    parts = ["Figure 6: inside the networks for the same pair."]
    if "early" in methods:
        parts.append("early: the depth map of the region of interest, beside the sensor's.")
    if "mid" in methods:
        parts.append(
            "mid: a slice through the fine volume from above, its features as colours, and where "
            "the nine keypoints are believed to be. Rings: true keypoints, crosses: predicted."
        )
    return " ".join(parts)


def _origin_section(document: Mapping[str, Any]) -> str:
    records = document["records"]
    entries = [
        ("command", f"<code>python -m two_view_pose {escape(document['command'])}</code>"),
        ("seed", str(document["seed"])),
        (
            "versions",
            ", ".join(f"{escape(k)} {escape(v)}" for k, v in document["versions"].items()),
        ),
    ]
    commits = {c for r in records if r["metric"] == "run" for c in r["commits"].split()}
    if commits:
        entries.append(("commit", ", ".join(f"<code>{c[:12]}</code>" for c in sorted(commits))))
    for record in records:
        if record["metric"] == "test_set":
            settings = json.loads(record["settings"])
            seed = f", seed {settings['seed']}" if "seed" in settings else ""
            entries.append(
                (
                    f"{TESTS[record['scene']]} test",
                    f"{record['sequences']} sequences, {record['references']} reference frames, "
                    f"{record['value']} pairs{seed}",
                )
            )
    networks = {
        (r["method"], r["training"]): r["networks"] for r in records if r["metric"] == "run"
    }
    for method in METHODS:
        for (name, training), digest in networks.items():
            if name == method:
                label = f"{method} networks" + (f", {training}" if training else "")
                entries.append((label, f"<code>{digest}</code>"))
    return definitions(entries)
