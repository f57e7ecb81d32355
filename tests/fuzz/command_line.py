"""Values on the command line: every option of every command, with values of all kinds."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from two_view_pose.__main__ import COMMANDS, check_outputs, find
from two_view_pose.core.errors import InputError

from .judge import Reader, require

VALUES = (
    "0", "1", "-1", "2", "0.5", "-0.5", "1e9", "1e400", "nan", "inf", "-inf", "9" * 30, "9" * 5000,
    "1_000", "", " ", "None", "True", "text", "²", "é", "a\tb", "../..", "/", "/proc/self/mem",
    ".", "linemod", "ape", "mid-pnp", "cpu", "cuda:99", "a,b,c,d", "1,2,3,4", "x" * 5000, "--",
    "no=such.ply", "file.safetensors", "{}",
)  # fmt: skip
"""What an option is given."""

REQUIRED = {
    "generate": ("--out", "data"),
    "record-bank": ("--out", "bank.npz"),
    "check-data": (".",),
    "train-estimator": ("--data", "data", "--out", "out"),
    "evaluate": (),
    "estimate": ("--reference", "a.png", "--object", "ape", "--K", "linemod"),
    "train-agent": ("--algo", "ppo", "--out", "out"),
    "evaluate-agent": ("--policy", "random"),
    "compare": ("--out", "out"),
    "demo": (),
    "doctor": (),
}


def _arguments(folder: Path, rng: np.random.Generator) -> tuple[str, list[str]]:
    names = list(COMMANDS)
    name = names[int(rng.integers(len(names)))]
    fields = dataclasses.fields(find(COMMANDS[name].config))
    options = list(REQUIRED[name])
    for _ in range(int(rng.integers(1, 4))):
        field = fields[int(rng.integers(len(fields)))]
        count = int(rng.choice([0, 1, 1, 1, 1, 1, 2, 2, 3]))
        chosen = [VALUES[i] for i in rng.integers(len(VALUES), size=count)]
        options += [f"--{field.name.replace('_', '-')}", *chosen]
    return name, options


def _parse(given: tuple[str, list[str]]) -> None:
    """Options become a config of plain, finite values, or are refused."""
    name, options = given
    command = COMMANDS[name]
    with contextlib.redirect_stderr(io.StringIO()) as errors:
        try:
            config = tyro.cli(find(command.config), prog=f"two_view_pose {name}", args=options)
        except SystemExit as error:
            require(error.code in (0, 2), f"exit code {error.code}")
            require(error.code == 0 or errors.getvalue(), "no message")
            raise InputError("usage") from error
    check_outputs(config, command)
    for field in dataclasses.fields(config):
        _check(getattr(config, field.name), f"{field.name} of {name}")


def _check(value: Any, name: str) -> None:
    if isinstance(value, float):
        require(math.isfinite(value), f"{name} is {value}")
    for part in value if isinstance(value, tuple | list) else ():
        _check(part, name)


COMMAND_LINE = {"command-line": Reader(lambda folder: None, (), _parse, _arguments, named=False)}
