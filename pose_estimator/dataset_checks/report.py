"""Prints what is wrong with a dataset: one row for equal findings."""

from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from .findings import Findings, Group

EXAMPLES = 2
STYLES = {"error": "bold red", "warning": "yellow"}


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
