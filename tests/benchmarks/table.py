"""Formats the records as a table for the terminal and in Markdown."""

from __future__ import annotations

from rich.table import Table

from .stopwatch import MISSING, Record

_COLUMNS = ("work", "against", "ours", "theirs", "ratio", "goal", "")


def table(records: list[Record]) -> Table:
    """The records that have a goal, for a terminal; costs against size are left to the figure."""
    title = " ".join(["side by side in one run, medians.", *measured_on(records)])
    shown = Table(title=title)
    for column in _COLUMNS:
        shown.add_column(column)
    for row in rows(records):
        shown.add_row(*row)
    return shown


def markdown(records: list[Record]) -> str:
    """The same in Markdown, a line each, after what it was measured on."""
    lines = [_COLUMNS, ("---",) * len(_COLUMNS), *rows(records)]
    text = "".join(f"| {' | '.join(line)} |\n".replace("|  |", "| |") for line in lines)
    return "".join(f"{line}\n\n" for line in measured_on(records)) + text


def measured_on(records: list[Record]) -> list[str]:
    """Returns the processor of the records, and where they do not hold."""
    text = "; ".join(dict.fromkeys(r["processor"] for r in records if "processor" in r))
    if not text:
        return []
    half = any(r.get("number_format") == "bfloat16" for r in records)
    only = " Lines marked bfloat16 hold only where the processor multiplies it." if half else ""
    return [f"Measured on {text}.{only}"]


def one_line(record: Record) -> str:
    """Formats a record as one line."""
    if record["metric"] == MISSING:
        against, reason, install = record["against"], record["reason"], record["install"]
        return f"not compared with {against} ({reason}). To install it: {install}"
    if "goal" not in record:
        return f"{record['value']:.3g} {record['unit']}  {record.get('work', record['metric'])}"
    work, against, *_, ratio, goal = cells(record)
    found = ratio or cells(record)[2]
    versus = f" | {against}" if against else ""
    return f"{found:>8}  {work}{versus} (goal {goal}: {'met' if met(record) else 'missed'})"


def rows(records: list[Record]) -> list[tuple[str, ...]]:
    """The cells of each record that has a goal, and whether it is met."""
    return [(*cells(r), "met" if met(r) else "missed") for r in records if "goal" in r]


def met(record: Record) -> bool:
    """Whether a record reaches its goal."""
    value, goal = record["value"], record["goal"]
    return bool(value <= goal if record.get("lower_is_better") else value >= goal)


def cells(record: Record) -> tuple[str, ...]:
    """A record as a row of the table."""
    if record.get("number_format") == "bfloat16" and "bfloat16" not in record.get("against", ""):
        record = {**record, "work": f"{record['work']} (bfloat16)"}
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
    """Formats the result of one side of a comparison."""
    if f"share{side}" in record:
        return f"{100 * record[f'share{side}']:.1f} %"
    if f"flops_per_second{side}" in record:
        return f"{record[f'flops_per_second{side}'] / 1e9:.0f} GFLOP/s"
    return f"{1000 * record[f'seconds{side}']:.3g} ms"
