"""What ``bench`` measured, as a table in the terminal and as one for a page."""

from __future__ import annotations

from typing import Any

from ..pose_estimator.stopwatch import Record

_COLUMNS = ("work", "against", "ours", "theirs", "ratio", "goal", "")


def table(records: list[Record]) -> Any:
    """The records that have a goal, for a terminal; costs against size are left to the figure."""
    from rich.table import Table

    shown = Table(title="side by side in one run, medians")
    for column in _COLUMNS:
        shown.add_column(column)
    for row in rows(records):
        shown.add_row(*row)
    return shown


def markdown(records: list[Record]) -> str:
    """The same in Markdown, a line each."""
    lines = [_COLUMNS, ("---",) * len(_COLUMNS), *rows(records)]
    return "".join(f"| {' | '.join(line)} |\n".replace("|  |", "| |") for line in lines)


def rows(records: list[Record]) -> list[tuple[str, ...]]:
    """The cells of each record that has a goal, and whether it is met."""
    return [(*cells(r), "met" if met(r) else "missed") for r in records if "goal" in r]


def met(record: Record) -> bool:
    """Whether a record reaches its goal."""
    value, goal = record["value"], record["goal"]
    return bool(value <= goal if record.get("lower_is_better") else value >= goal)


def cells(record: Record) -> tuple[str, ...]:
    """A record as a row of the table."""
    if record["metric"] == "memory_growth":
        value, goal = f"{record['value']:.1f} MB", f"<= {record['goal']:g} MB"
        return record["work"], "", value, "", "", goal
    if record["metric"] != "ratio":
        value, goal = f"{record['value']:.1f}/s", f">= {record['goal']:g}/s"
        return record["work"], "", value, "", "", goal
    ours, theirs = amount(record), amount(record, "_against")
    ratio, goal = f"{record['value']:.2f}x", f">= {record['goal']:.2g}x"
    return record["work"], record["against"], ours, theirs, ratio, goal


def amount(record: Record, side: str = "") -> str:
    """What one side of a comparison came to, for people."""
    if f"share{side}" in record:
        return f"{100 * record[f'share{side}']:.1f} %"
    if f"flops_per_second{side}" in record:
        return f"{record[f'flops_per_second{side}'] / 1e9:.0f} GFLOP/s"
    return f"{1000 * record[f'seconds{side}']:.3g} ms"
