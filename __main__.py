"""One command line: ``python -m two_view_pose VERB [OPTIONS]``.

Each verb has one config dataclass, whose fields tyro turns into options, and one function that
takes it. Only the chosen verb's modules are imported, the function's after the options have been
read, so that help is quick.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple

PROGRAM = "two_view_pose"


class Verb(NamedTuple):
    """Where a verb lives, as ``module:name`` below this package.

    Attributes:
        config: its config dataclass; what it parses costs no more than importing that module.
        function: the function that takes the config; what it returns, if an integer, is the exit
            code.
        summary: one line for the list of verbs.
    """

    config: str
    function: str
    summary: str


VERBS = {
    "demo": Verb(
        "agents.demo:DemoConfig",
        "agents.demo:demo",
        "one scene, two views, the pose before and after; writes a picture",
    ),
    "generate": Verb(
        "envs.generate_config:GenerateConfig",
        "envs.generate:generate",
        "renders paired training or test data and writes it in BOP format",
    ),
    "record-bank": Verb(
        "envs.record_config:RecordBankConfig",
        "envs.record_bank:record_bank",
        "records every second view of many scenes, to train and test on",
    ),
    "check-data": Verb(
        "pose_estimator.check_data:CheckDataConfig",
        "pose_estimator.check_data:check_data",
        "finds the usual mistakes in a BOP data set",
    ),
    "train-estimator": Verb(
        "pose_estimator.training_config:TrainEstimatorConfig",
        "pose_estimator.training:train_estimator",
        "trains the pose estimator on generated data",
    ),
    "evaluate": Verb(
        "pose_estimator.evaluate_config:EvaluateConfig",
        "envs.evaluate:evaluate",
        "ADD(-S) of an estimator on our scenes or on a BOP data set",
    ),
    "estimate": Verb(
        "pose_estimator.estimate_command:EstimateConfig",
        "pose_estimator.estimate_command:estimate_files",
        "the pose of an object in your own two photographs",
    ),
    "train-agent": Verb(
        "agents.config:TrainAgentConfig",
        "agents.train:train_agent",
        "trains a policy that chooses the second view",
    ),
    "evaluate-agent": Verb(
        "agents.config:EvaluateAgentConfig",
        "agents.evaluate:evaluate_agents",
        "compares policies on the same scenes",
    ),
    "compare": Verb(
        "pose_estimator.study_config:CompareConfig",
        "envs.compare:compare",
        "all methods on the same two tests: tables, figures and a page",
    ),
    "doctor": Verb(
        "envs.doctor:DoctorConfig",
        "envs.doctor:doctor",
        "says what works on this machine and what to install",
    ),
}


def overview() -> str:
    """The help text that lists the verbs."""
    width = max(map(len, VERBS))
    lines = [f"  {name:<{width}}  {verb.summary}" for name, verb in VERBS.items()]
    return "\n".join(
        [
            f"usage: {PROGRAM} [-h] [--version] [--debug] VERB [OPTIONS]",
            "",
            "Where should a robot look from for its second view?",
            "",
            "verbs:",
            *lines,
            "",
            f"`{PROGRAM} VERB --help` lists a verb's options. --debug shows where an error arose.",
        ]
    )


def message(error: Exception) -> str:
    """One line for the user."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__


def find(place: str) -> Any:
    """What stands at ``module:name`` below this package."""
    module, name = place.split(":")
    return getattr(import_module(f".{module}", __package__), name)


def run(arguments: Sequence[str]) -> int:
    """Runs one verb with its options and returns the exit code.

    Raises:
        ValueError: or OSError, from the verb.
    """
    import tyro

    name, *options = arguments
    verb = VERBS[name]
    config = tyro.cli(find(verb.config), prog=f"{PROGRAM} {name}", args=options)
    code = find(verb.function)(config)
    return code if isinstance(code, int) else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns 0, 1 (a check failed), 2 (wrong input) or 130 (interrupted)."""
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
    if given[0] not in VERBS:
        print(
            f"error: unknown verb {given[0]!r}; the verbs are {', '.join(VERBS)}", file=sys.stderr
        )
        return 2
    try:
        return run(given)
    except (ValueError, OSError) as error:
        if debug:
            raise
        print(f"error: {message(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
