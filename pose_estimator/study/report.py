"""Renders the study as one HTML page, from results.json and the images in figures/."""

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, UndefinedError

from ...core.errors import InputError
from ...core.files import write_atomically
from ...core.results import read_results
from .. import METHODS
from . import published, report_tables
from .claims import findings
from .figures import draw_charts

FIGURES = ("gaps", "fusions", "poses")
"""Names of the drawn figures, each followed by a number: the paper's 3, 5 and 6."""


def write_report(folder: Path) -> Path:
    """Draws the charts and writes report.html into the folder of a study; returns its path.

    Raises:
        InputError: if results.json is missing or broken.
    """
    results = folder / "results.json"
    if not results.is_file():
        raise InputError(f"{folder} holds no results.json; run compare without --report-only first")
    document = read_results(results)
    images = [p for n in FIGURES for p in sorted((folder / "figures").glob(f"{n}_*.png"))]
    try:
        charts = draw_charts(document["records"], folder / "figures")
        page = report_page(document, charts, images)
    except (OSError, InputError):
        raise
    except (AttributeError, LookupError, TypeError, ValueError, UndefinedError) as error:
        raise InputError(
            f"{results} is not of a study, or damaged ({error!r:.200}): run compare again"
        ) from error
    target = folder / "report.html"
    write_atomically(target, page.encode())
    return target


def report_page(
    document: Mapping[str, Any], charts: Mapping[str, Path], images: Sequence[Path]
) -> str:
    """Renders results.json as one self-contained page.

    ``charts`` are SVG files by name, ``images`` the files of ``FIGURES``.
    """
    records = document["records"]
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2").render(
        command=document["command"],
        tests=report_tables.TESTS,
        paper=published,
        missing=[r for r in records if r["metric"] == "missing"],
        methods={r.get("method") for r in records if r["metric"] == "add_s_recall"},
        keypoint_tables=_by_test(records, report_tables.keypoint_table),
        recall_tables=_by_test(records, report_tables.recall_table),
        published_tables=_by_test(records, lambda _, test: report_tables.published_table(test)),
        claims=findings(records),
        visibility_table=report_tables.visibility_table(records),
        solver_table=report_tables.solver_table(records),
        noise_table=report_tables.noise_table(records),
        training_table=report_tables.training_table(records),
        cost_table=report_tables.cost_table(records),
        charts={name: data_uri(path) for name, path in charts.items()},
        images=[(path.stem, data_uri(path)) for path in images],
        origin=_origin(document),
    )


def data_uri(path: Path) -> str:
    """Encodes an SVG or PNG file as a data URI."""
    data = base64.b64encode(path.read_bytes()).decode()
    return f"data:image/{'svg+xml' if path.suffix == '.svg' else 'png'};base64,{data}"


def _by_test(records: report_tables.Records, make: Any) -> dict[str, report_tables.Table]:
    """Makes the table of each test that has results."""
    tables = {test: make(records, test) for test in report_tables.TESTS}
    return {test: table for test, table in tables.items() if table is not None}


def _origin(document: Mapping[str, Any]) -> dict[str, Sequence[str]]:
    """Returns how the results were made: texts by name; a list is set as code."""
    runs = [r for r in document["records"] if r["metric"] == "run"]
    versions = ", ".join(f"{name} {version}" for name, version in document["versions"].items())
    entries: dict[str, Sequence[str]] = {
        "command": [f"python -m two_view_pose {document['command']}"],
        "seed": str(document["seed"]),
        "versions": versions,
    }
    commits = sorted({commit for run in runs for commit in run["commits"].split()})
    if commits:
        entries["commit"] = [commit[:12] for commit in commits]
    for record in document["records"]:
        if record["metric"] == "test_set":
            settings = json.loads(record["settings"])
            seed = f", seed {settings['seed']}" if "seed" in settings else ""
            entries[f"{report_tables.TESTS[record['scene']]} test"] = (
                f"{record['sequences']} sequences, {record['references']} reference frames, "
                f"{record['value']} pairs{seed}"
            )
    for run in sorted(runs, key=lambda run: METHODS.index(run["method"])):
        training = f", {run['training']}" if run["training"] else ""
        entries[f"{run['method']} networks{training}"] = [run["networks"]]
    return entries
