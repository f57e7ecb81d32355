"""The command ``check-data``: what is wrong with a BOP dataset, and what to do about it."""

from .config import CheckDataConfig


def check_data(config: CheckDataConfig) -> int:
    """Checks a dataset, prints what was found, and returns the exit code.

    Raises:
        InputError: if there is no such dataset, or an option is wrong.
    """
    from rich.console import Console

    from ...core.results import write_results
    from ..bop.find_dataset import find_dataset
    from .checks import counted, find_mistakes
    from .overlays import draw_overlays
    from .report import print_findings

    root = find_dataset(config.data)
    findings, wrong, summary = find_mistakes(config, root)
    console = Console(highlight=False)
    print_findings(findings, root, console)
    errors, warnings = findings.count("error"), findings.count("warning")
    console.print(f"{root}: {summary}", soft_wrap=True)
    console.print(f"{counted(errors, 'error')}, {counted(warnings, 'warning')}")
    if config.out is not None:
        for path in draw_overlays(wrong, config.out, config.overlays):
            console.print(f"overlay: {path}", soft_wrap=True)
    if config.json is not None:
        records = [
            {"metric": "errors", "value": errors, "unit": "1"},
            {"metric": "warnings", "value": warnings, "unit": "1"},
            *findings.records(),
        ]
        write_results(config.json, records, command=f"check-data {root.name}", seed=None)
    return int(errors > 0)
