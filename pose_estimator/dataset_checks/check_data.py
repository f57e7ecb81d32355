"""The command ``check-data``: finds mistakes in a BOP dataset and suggests corrections."""

from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ...core.results import write_results
from ..bop.find_dataset import find_dataset
from .checks import find_mistakes
from .config import CheckDataConfig
from .coverage import counted
from .findings import Findings, Group
from .overlays import draw_overlays

EXAMPLES = 2
STYLES = {"error": "bold red", "warning": "yellow"}


def check_data(config: CheckDataConfig) -> int:
    """Checks a dataset, prints the findings, and returns the exit code.

    Raises:
        InputError: if there is no such dataset, or an option is wrong.
    """
    root = find_dataset(config.data)
    findings, wrong, coverage = find_mistakes(config, root)
    console = Console(highlight=False)
    print_findings(findings, root, console)
    errors, warnings = findings.count("error"), findings.count("warning")
    console.print(f"{root}: {coverage}", soft_wrap=True)
    for note in coverage.notes():
        console.print(f"not checked: {note}", soft_wrap=True)
    console.print(f"{counted(errors, 'error')}, {counted(warnings, 'warning')}")
    if config.out is not None:
        for path in draw_overlays(wrong, config.out, config.overlays):
            console.print(f"overlay: {path}", soft_wrap=True)
    if config.json is not None:
        records = [
            {"metric": "errors", "value": errors, "unit": "1"},
            {"metric": "warnings", "value": warnings, "unit": "1"},
            *coverage.records(),
            *findings.records(),
        ]
        write_results(config.json, records, command=f"check-data {root.name}", seed=None)
    return int(errors > 0)


def print_findings(findings: Findings, root: Path, console: Console) -> None:
    """Prints a table of all groups; nothing where there are none."""
    groups = findings.groups()
    if not groups:
        return
    table = Table(show_lines=True, expand=False)
    table.add_column("", no_wrap=True)
    table.add_column("times", justify="right", no_wrap=True)
    table.add_column("file, field", ratio=1, min_width=18, overflow="fold")
    table.add_column("what is wrong, why, and what to do", ratio=3, overflow="fold")
    for group in groups:
        first = group.first
        table.add_row(
            Text(first.severity, style=STYLES[first.severity]),
            f"{group.count}",
            Text(f"{first.kind}\n{first.field}"),
            _describe(group, root),
        )
    console.print(table)


def _describe(group: Group, root: Path) -> Text:
    first = group.first
    text = Text(first.problem, style="bold")
    for label, sentence in (("probably", first.cause), ("do", first.remedy)):
        if sentence:
            text.append(f"\n{label}: ", style="cyan not bold").append(sentence, style="not bold")
    for finding in group.kept[:EXAMPLES]:
        text.append("\n- " + finding.example(root), style="dim not bold")
    if group.count > EXAMPLES:
        text.append(f"\n- and {group.count - EXAMPLES} more", style="dim not bold")
    return text
