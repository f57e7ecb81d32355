"""One command line: ``python -m two_view_pose COMMAND [OPTIONS]``.

Each command has one config dataclass, whose fields tyro turns into options, and one function that
takes it. Only the chosen command's modules are imported, the function's after the options have been
read, so that help is quick.
"""

import errno
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from .core.closed_output import close_broken_output
from .core.errors import InputError, InputWarning
from .core.files import check_output

PROGRAM = "two_view_pose"

LONGEST_MESSAGE = 1500
"""Letters of an error that are printed."""


class Command(NamedTuple):
    """Where a command lives, as ``module:name`` below this package.

    Attributes:
        config: its config dataclass; what it parses costs no more than importing that module.
        function: the function that takes the config; what it returns, if an integer, is the exit
            code.
        summary: one line for the list of commands.
        writes_file: whether ``--out`` is a file, not a folder.
    """

    config: str
    function: str
    summary: str
    writes_file: bool = False


COMMANDS = {
    "demo": Command(
        "agents.evaluation.demo:DemoConfig",
        "agents.evaluation.demo:demo",
        "one scene, two views, the pose before and after; writes an image",
        writes_file=True,
    ),
    "generate": Command(
        "envs.datagen.config:GenerateConfig",
        "envs.datagen.generate:generate",
        "renders paired training or test data and writes it in BOP format",
    ),
    "record-bank": Command(
        "envs.recording.config:RecordBankConfig",
        "envs.recording.record_bank:record_bank",
        "records every second view of many scenes, to train and test on",
        writes_file=True,
    ),
    "check-data": Command(
        "pose_estimator.dataset_checks.config:CheckDataConfig",
        "pose_estimator.dataset_checks.check_data:check_data",
        "finds the usual mistakes in a BOP data set",
    ),
    "train-estimator": Command(
        "pose_estimator.training.config:TrainEstimatorConfig",
        "pose_estimator.training.train_estimator:train_estimator",
        "trains the pose estimator on generated data",
    ),
    "evaluate": Command(
        "pose_estimator.evaluation.config:EvaluateConfig",
        "envs.commands.evaluate:evaluate",
        "ADD(-S) of an estimator on our scenes or on a BOP data set",
    ),
    "estimate": Command(
        "pose_estimator.fusion.estimate_config:EstimateConfig",
        "pose_estimator.fusion.estimate_files:estimate_files",
        "the pose of an object in your own two photographs",
        writes_file=True,
    ),
    "train-agent": Command(
        "agents.training.config:TrainAgentConfig",
        "agents.training.train_agent:train_agent",
        "trains a policy that chooses the second view",
    ),
    "evaluate-agent": Command(
        "agents.training.config:EvaluateAgentConfig",
        "agents.evaluation.evaluate_agent:evaluate_agents",
        "compares policies on the same scenes",
    ),
    "compare": Command(
        "pose_estimator.study.config:CompareConfig",
        "envs.commands.compare:compare",
        "all methods on the same two tests: tables, figures and a page",
    ),
    "doctor": Command(
        "envs.commands.doctor:DoctorConfig",
        "envs.commands.doctor:doctor",
        "says what works on this machine and what to install",
    ),
}


def overview() -> str:
    """The help text that lists the commands."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {command.summary}" for name, command in COMMANDS.items()]
    return "\n".join(
        [
            f"usage: {PROGRAM} [-h] [--version] [--debug] COMMAND [OPTIONS]",
            "",
            "Where should a robot look from for its second view?",
            "",
            "commands:",
            *lines,
            "",
            f"`{PROGRAM} COMMAND --help` lists its options. --debug shows where an error arose.",
        ]
    )


def message(error: Exception) -> str:
    """One line for the user."""
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        return _short(text) + "; free some, then run the same command again" * full
    return _short(" ".join(str(error).split())) or type(error).__name__


def _short(text: str) -> str:
    """Leaves out the middle of a text that repeats most of a damaged file."""
    if len(text) <= LONGEST_MESSAGE:
        return text
    return f"{text[: LONGEST_MESSAGE - 300]} [...] {text[-300:]}"


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Prints a warning of wrong input as one line, others as Python does."""
    text = warnings.formatwarning(message, category, filename, lineno, line)
    if issubclass(category, InputWarning):
        text = f"warning: {' '.join(str(message).split())}\n"
    (file or sys.stderr).write(text)


def find(place: str) -> Any:
    """What stands at ``module:name`` below this package."""
    module, name = place.split(":")
    return getattr(import_module(f".{module}", __package__), name)


def check_outputs(config: Any, command: Command) -> None:
    """Checks that the outputs of a command can be written.

    Raises:
        InputError: if one cannot.
    """
    for name in ("out", "json", "csv", "overlay", "figures", "cache_dir"):
        path = getattr(config, name, None)
        if isinstance(path, Path):
            is_file = command.writes_file if name == "out" else name in ("json", "csv", "overlay")
            check_output(path, name, folder=not is_file)


def run(arguments: Sequence[str]) -> int:
    """Runs one command with its options and returns the exit code.

    Raises:
        InputError: if there is no such command.
        InputError, OSError: from the command.
    """
    import tyro

    name, *options = arguments
    command = COMMANDS.get(name)
    if command is None:
        raise InputError(f"unknown command {name!r}; the commands are {', '.join(COMMANDS)}")
    config = tyro.cli(find(command.config), prog=f"{PROGRAM} {name}", args=options)
    check_outputs(config, command)
    code = find(command.function)(config)
    return code if isinstance(code, int) else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line.

    Returns:
        0, 1 (a check failed), 2 (wrong input), 130 (interrupted), or 141 (nobody reads the output
        any more, as after ``| head -1``).
    """
    try:
        try:
            return _main(arguments)
        finally:
            sys.stdout.flush()
    except BrokenPipeError as error:
        if close_broken_output():
            return 141
        print(f"error: {message(error)}", file=sys.stderr)
        return 2


def _main(arguments: Sequence[str] | None) -> int:
    given = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in given or bool(os.environ.get("TWO_VIEW_POSE_DEBUG"))
    given = [argument for argument in given if argument != "--debug"]
    if not given or given[0] in ("-h", "--help"):
        print(overview())
        return 0 if given else 2
    if given[0] == "--version":
        from . import __version__

        print(f"{PROGRAM} {__version__}")
        return 0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", InputWarning)
            warnings.showwarning = show_warning
            return run(given)
    except BrokenPipeError:
        raise
    except (InputError, OSError) as error:
        if debug:
            raise
        print(f"error: {message(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
