"""The report: results, missing methods, and one self-contained page."""

import base64
import json
import re
from html.parser import HTMLParser

import pytest
from helpers.study_cases import outcome
from two_view_pose.core.results import write_results
from two_view_pose.pose_estimator.study.plan import NOISE, NOISY, Run
from two_view_pose.pose_estimator.study.report import report_page, write_report
from two_view_pose.pose_estimator.study.tables import tables


def outcomes(share: float, distance: float, gaps=(1, 5, 10)):
    """Ten sequences of a cat and a duck; this share of the cat is correct, and every duck."""
    solvers = {"soft": 0.05, "soft-mean": 0.2, "kabsch": 0.2, "hard": 0.05}
    return [
        outcome(s, name, gap, 0.05 if name == "duck" or s < 10 * share else 0.3, distance / gap,
                solvers=solvers)
        for s in range(10) for gap in gaps for name in ("cat", "duck")
    ]  # fmt: skip


@pytest.fixture(scope="module")
def records() -> list[dict]:
    measured = {
        Run("main", "linemod", "mid"): outcomes(0.9, 0.02),
        Run("main", "linemod", "late"): outcomes(0.4, 0.04),
        Run("main", "occlusion", "mid"): outcomes(0.7, 0.05),
        Run("training", "linemod", "mid", "no-pose-loss", (10,)): outcomes(0.2, 0.09, (10,)),
        **{
            Run("noise", "linemod", "mid", training, (10,), 0, 0, r, t): outcomes(
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
         "reason": "the weights lack <cascade>"},
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


class Rows(HTMLParser):
    """The rows of every table of a page: the cells' classes, texts and whether they are bold."""

    def __init__(self, text: str):
        super().__init__()
        self.rows: list[list[dict]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append({"class": dict(attributes).get("class", ""), "text": ""})
        elif tag == "b" and "td" in self.open:
            self.rows[-1][-1]["best"] = True

    def handle_endtag(self, tag):
        while self.open and self.open.pop() != tag:  # such as <meta>, which is never closed
            pass

    def handle_data(self, text):
        if {"td", "th"} & set(self.open) and "small" not in self.open:
            self.rows[-1][-1]["text"] += text


def cells(text: str, row: str) -> list[str]:
    """The cells of the first row that begins with this cell; the best are marked with a star."""
    found = next(r for r in Rows(text).rows if r and r[0]["text"] == row)
    return ["*" * c.get("best", False) + c["text"] for c in found[1:]]


def section(text: str, title: str) -> str:
    """The page from this title on."""
    return text[text.index(title) :]


def test_tables_hold_the_results(text):
    # Distances are 20 / gap and 40 / gap mm; then the paper's early, late, mid and REDE.
    ours = ["–", "–", "4.0", "*2.0", "–", "–", "–"]
    assert cells(text, "10") == [*ours, "31", "11", "7", "–"]
    recall = section(text, "Table 2")
    assert cells(recall, "cat") == ["–", "–", "40.0", "*90.0", "–", "–", "–", "98.3", "10"]
    assert cells(recall, "mean") == ["–", "–", "70.0", "*95.0", "–", "–", "–", "97.5", "20"]
    own = section(text, "The paper's own Table 2")
    assert cells(own, "eggbox *")[:2] == ["96.8", "99.1"] and "GDR-Net" in own
    # Alone in its row, a result is not the best of anything.
    assert cells(section(text, "Table 3"), "cat")[3] == "70.0"
    assert cells(text, "mid") == ["106", "51"]
    assert cells(text, "2°, 10 mm")[:2] == ["75.0"] * 2  # a draw
    assert "ms a pair, 2 threads" in text


def test_results_have_intervals(text):
    assert re.search(r"<b>90\.0</b>\s*<small>\d+\.\d to \d+\.\d</small>", text)
    assert "mid, pair by pair: +25.0 points over late (" in text


def test_solvers_and_trainings_are_shown(text):
    row = cells(text, "Occlusion-style, mid")
    assert row == ["*100.0", "0.0", "0.0", "*100.0", "+100.0", "+100.0", "+0.0"]
    row = cells(text, "no-pose-loss, LineMOD-style, gap 10")
    assert row[:3] == ["*95.0", "60.0", "+35.0"]


def test_a_missing_method_is_named_with_its_reason(text):
    assert "<b>early</b>: the weights lack &lt;cascade&gt;" in text


def test_published_results_have_their_own_column(text):
    published = {"97.5", "66.6", "31", "94.1"}
    found = [c for row in Rows(text).rows for c in row if c["text"] in published]
    assert {c["text"] for c in found} == published
    assert all("paper" in c["class"] for c in found)


def test_provenance_is_shown(text):
    assert "compare --out study" in text and "c0ffee00" in text and "seed 8001" in text
    assert "0123abcd" in text and re.search(r"numpy \d", text)


def test_the_page_is_self_contained(text):
    assert not re.search(r"(src|href)=\"(?!data:|#)", text)
    assert "<script" not in text and "@import" not in text and "url(" not in text
    assert text.count("data:image/svg+xml;base64,") == 3  # both recalls and the errors


def test_links_lead_to_existing_sections(text):
    links = re.findall(r'<a href="#(\w+)">([^<]*)</a>', text)
    assert links == re.findall(r'<h2 id="(\w+)">([^<]*)</h2>', text)
    assert ("s1", "Keypoints in space") in links
    assert "Images" not in dict(links).values()


@pytest.mark.slow
def test_images_are_embedded_in_order(records, tmp_path):
    write_results(tmp_path / "results.json", records, command="compare", seed=0)
    (tmp_path / "figures").mkdir()
    for name in ("poses_1", "fusions_2", "gaps_1", "fusions_1"):
        (tmp_path / "figures" / f"{name}.png").write_bytes(name.encode())
    text = write_report(tmp_path).read_text()
    images = re.findall(r'src="data:image/png;base64,([^"]*)"', text)
    assert [base64.b64decode(p).decode() for p in images] == [
        "gaps_1", "fusions_1", "fusions_2", "poses_1",
    ]  # fmt: skip
    assert text.index("Figure 3:") < text.index("Figure 5:") < text.index("Figure 6:")


def test_a_quick_run_is_marked(records):
    document = {"command": "compare --quick", "versions": {}, "seed": 0, "records": records}
    assert "A quick run" in report_page(document, {}, [])
    assert "A quick run" not in report_page(document | {"command": "compare"}, {}, [])


def test_an_empty_report_has_no_tables(tmp_path):
    write_results(tmp_path / "results.json", [], command="compare", seed=0)
    text = write_report(tmp_path).read_text()
    assert "<table" not in text and "How it was made" in text


def test_missing_results_are_an_error(tmp_path):
    with pytest.raises(ValueError, match=r"no results\.json"):
        write_report(tmp_path)


def test_results_of_another_command_are_refused(tmp_path):
    record = {"metric": "test_set", "value": 60, "unit": "pairs"}
    write_results(tmp_path / "results.json", [record], command="evaluate", seed=0)
    with pytest.raises(ValueError, match=r"results\.json is not of a study, or damaged"):
        write_report(tmp_path)
