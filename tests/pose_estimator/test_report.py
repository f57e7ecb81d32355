"""The study's page: it holds the figures, names what is missing, and stands alone."""

import json
import re

import pytest
from study_cases import outcome
from two_view_pose.pose_estimator.published import published
from two_view_pose.pose_estimator.report import report_page, write_report
from two_view_pose.pose_estimator.report_html import Cell, figure, page, table
from two_view_pose.pose_estimator.report_tables import cost_table, recall_table
from two_view_pose.pose_estimator.results import write_results
from two_view_pose.pose_estimator.study_tables import tables
from two_view_pose.pose_estimator.study_units import NO_POSE_LOSS, NOISE, NOISY, Unit


def outcomes(share: float, distance: float, gaps=(1, 5, 10)):
    """Ten sequences of a cat and a duck; of the cat this share is right, of the duck all."""
    solvers = {"soft": 0.05, "kabsch": 0.2, "hard": 0.05}
    return [
        outcome(s, name, gap, 0.05 if name == "duck" or s < 10 * share else 0.3, distance / gap,
                solvers=solvers)
        for s in range(10) for gap in gaps for name in ("cat", "duck")
    ]  # fmt: skip


@pytest.fixture(scope="module")
def records() -> list[dict]:
    measured = {
        Unit("main", "linemod", "mid"): outcomes(0.9, 0.02),
        Unit("main", "linemod", "late"): outcomes(0.4, 0.04),
        Unit("main", "occlusion", "mid"): outcomes(0.7, 0.05),
        Unit("training", "linemod", "mid", NO_POSE_LOSS, (10,)): outcomes(0.2, 0.09, (10,)),
        **{
            Unit("noise", "linemod", "mid", training, (10,), 0, 0, r, t): outcomes(
                0.9 - 0.2 * r, 0.02, (10,)
            )
            for training in ("", NOISY)
            for r, t in NOISE
        },
    }
    cost = {"metric": "seconds_per_pair", "unit": "s", "threads": 2}
    return [
        *tables(measured),
        {**cost, "method": "mid", "value": 0.1064, "batch": 1},
        {**cost, "method": "mid", "value": 0.0512, "batch": 16},
        {"metric": "missing", "value": 1, "unit": "", "method": "early", "training": "",
         "scene": "", "reason": "the weights lack <cascade>"},
        {"metric": "run", "value": 60, "unit": "pairs", "scene": "linemod", "method": "mid",
         "training": "", "networks": "0123abcd", "commits": "c0ffee00c0ffee00"},
        {"metric": "test_set", "value": 60, "unit": "pairs", "scene": "linemod", "sequences": 10,
         "references": 10, "settings": json.dumps({"seed": 8001})},
    ]  # fmt: skip


@pytest.fixture(scope="module")
def text(records, tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("study")
    write_results(folder / "results.json", records, command="compare --out study", seed=3)
    return write_report(folder).read_text()


def cells(text: str, row: str) -> list[str]:
    """The cells of the first row that begins with this cell, without their small print."""
    found = re.search(rf"<tr[^>]*><td[^>]*>{re.escape(row)}(?:</td>|<small>)(.*?)</tr>", text)
    assert found, row
    plain = re.sub(r"<small>.*?</small>", "", found[1])
    return re.findall(r"<td[^>]*>(.*?)</td>", plain)


def test_tables_hold_the_figures(text, records):
    # early is missing; distances 20 / gap and 40 / gap mm; the paper's 7 mm at gap 10.
    assert cells(text, "10") == ["–", "<b>2.0</b>", "4.0", "–", "7.0"]
    recall = recall_table(records, "linemod")
    assert cells(recall, "cat") == ["–", "–", "40.0", "<b>90.0</b>", "–", "–", "10"]
    assert cells(recall, "mean") == ["–", "–", "70.0", "<b>95.0</b>", "–", "97.5", "20"]
    # Alone in its row, a figure is not the best of anything.
    assert cells(recall_table(records, "occlusion"), "cat")[3] == "70.0"
    assert cells(text, "mid") == ["106", "51"]
    assert cells(text, "2°, 10 mm")[:2] == ["75.0"] * 2  # a draw


def test_solvers_and_trainings_are_shown(text):
    assert cells(text, "Occlusion-style, mid") == ["<b>100.0</b>", "0.0", "<b>100.0</b>",
                                                   "+100.0", "+0.0"]  # fmt: skip
    row = cells(text, "no pose loss, LineMOD-style")
    assert row[:3] == ["<b>95.0</b>", "60.0", "+35.0"]


def test_a_missing_method_is_named_with_its_reason(text):
    assert "<b>early</b>: the weights lack &lt;cascade&gt;" in text


def test_published_figures_stand_apart(text):
    for match in re.finditer(r"<td( class=\"[^\"]*\")?>(97\.5|66\.6|13\.0|7\.0)<", text):
        assert match[1] and "paper" in match[1]


def test_the_page_says_where_it_comes_from(text):
    assert "compare --out study" in text and "c0ffee00" in text and "seed 8001" in text
    assert re.search(r"numpy \d", text)


def test_the_page_stands_alone(text):
    assert not re.search(r"(src|href)=\"(?!data:|#)", text)
    assert "<script" not in text and "@import" not in text and "url(" not in text
    assert text.count("data:image/svg+xml;base64,") == 3  # both recalls and the errors


def test_a_quick_run_says_so(records):
    document = {"command": "compare --quick", "versions": {}, "seed": 0, "records": records}
    assert "A quick run" in report_page(document, {}, [])
    assert "A quick run" not in report_page(document | {"command": "compare"}, {}, [])


def test_a_report_of_nothing_still_says_what_must_be(tmp_path):
    write_results(tmp_path / "results.json", [], command="compare", seed=0)
    text = write_report(tmp_path).read_text()
    assert text.count("not measured") == 8 and "Table 2" not in text


def test_no_results_are_an_error(tmp_path):
    with pytest.raises(ValueError, match=r"no results\.json"):
        write_report(tmp_path)


def test_only_figures_of_the_paper_are_published():
    assert published("keypoint_distance", "mid", "linemod", gap="mean") == 0.013
    assert published("add_s_recall", "mid", "occlusion", gap=10) == 0.666
    assert published("add_s_recall", "mid", "linemod", object_name="cat", gap=10) is None
    assert published("add_s_recall", "rgbd", "occlusion", gap=10) is None


def test_text_is_escaped():
    assert "&lt;b&gt;" in Cell("<b>").html() and "&amp;" in Cell("1", "a & b").html()
    assert "<title>a &lt; b</title>" in page("a < b", [], "")
    assert table(["<"], [["&"]]).count("&lt;") == 1


def test_pictures_of_other_kinds_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"got x\.gif"):
        figure(tmp_path / "x.gif", "")


def test_one_thread_is_one_thread():
    record = {"metric": "seconds_per_pair", "method": "mid", "batch": 1, "threads": 1, "value": 1}
    assert "1 thread<" in cost_table([record])
