"""Policies side by side on the same scenes."""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from ..pose_estimator.results import write_results
from .baselines import BASELINES, Policy, make_policy
from .config import BOX_ENV, DISCRETE_ENV, EvaluateAgentConfig

FIRST_VIEW = "first-view"
"""The row for what the first view alone gives."""

SUCCESS = 0.1
"""An estimate is right if ADD(-S) is below this fraction of the object's diameter."""


@dataclass(frozen=True)
class Outcome:
    """What came of one episode.

    Attributes:
        object_name: the target.
        add_over_diameter: ADD(-S) of the final estimate over the object's diameter.
        travel: camera travel, metres.
    """

    object_name: str
    add_over_diameter: float
    travel: float


def evaluate_agents(config: EvaluateAgentConfig) -> list[dict[str, Any]]:
    """Runs every policy on the same scenes, prints a table and writes the results file if asked.

    Args:
        config: see `EvaluateAgentConfig`.

    Returns:
        The records of the results file: ``add_s_recall``, ``add_over_diameter`` and ``travel`` of
        each policy, and of ``first-view``, over all objects (``object`` is ``mean``) and for each.

    Raises:
        ValueError: if an argument is wrong, or a file is no agent for this environment.
    """
    env = gym.make(_environment_id(config), **config.environment_arguments)
    try:
        policies = {name: make_policy(name, env) for name in config.policy}
        outcomes = run_episodes(env, policies, config.episodes, config.seed, config.progress)
    finally:
        env.close()
    print_table(outcomes, config.scene)
    records = make_records(outcomes, config.scene)
    if config.json is not None:
        write_results(config.json, records, command=_command(config), seed=config.seed)
    return records


def run_episodes(
    env: gym.Env,
    policies: Mapping[str, Policy],
    episodes: int,
    seed: int,
    progress: bool = False,
) -> dict[str, list[Outcome]]:
    """Runs every policy on the same ``episodes`` scenes.

    Args:
        env: an environment that reports ``object``, ``diameter``, ``travel`` and, under
            ``ground_truth``, ``add_first`` and ``add_second``.
        policies: the policies by name.
        episodes: number of scenes.
        seed: seed of the scenes and of what policies draw; a policy's outcomes depend neither on
            the other policies nor on their order.
        progress: show a progress bar.

    Returns:
        One outcome a scene for each policy, in the same order, and for ``first-view``.

    Raises:
        ValueError: if the environment has no estimator, so that there is nothing to compare.
    """
    outcomes: dict[str, list[Outcome]] = {FIRST_VIEW: [], **{name: [] for name in policies}}
    bar = tqdm(total=episodes * len(policies), unit="episode", disable=not progress)
    for sequence in np.random.SeedSequence(seed).spawn(episodes):
        scene_seed = int(sequence.generate_state(1)[0])
        for i, (name, policy) in enumerate(policies.items()):
            observation, info = env.reset(seed=scene_seed)
            if "add_first" not in info["ground_truth"]:
                raise ValueError("estimator must not be None: without one there is no pose to rate")
            if i == 0:
                outcomes[FIRST_VIEW].append(_outcome(info, "add_first"))
            policy.reset(np.random.default_rng(sequence))
            terminated = truncated = False
            while not (terminated or truncated):
                action = policy.act(observation)
                observation, _, terminated, truncated, info = env.step(action)
            outcomes[name].append(_outcome(info, "add_second"))
            bar.update()
    bar.close()
    return outcomes


def make_records(outcomes: Mapping[str, Sequence[Outcome]], scene: str) -> list[dict[str, Any]]:
    """The numbers of a results file, with 95 percent intervals over scenes."""
    records = []
    for policy, results in outcomes.items():
        names = sorted({result.object_name for result in results})
        for name in ["mean", *names]:
            chosen = [result for result in results if name in ("mean", result.object_name)]
            tags = {"policy": policy, "scene": scene, "object": name, "n": len(chosen)}
            for metric, unit, (value, low, high) in _statistics(chosen):
                interval = {"low": low, "high": high}
                records.append({"metric": metric, "value": value, "unit": unit, **tags, **interval})
    return records


def print_table(outcomes: Mapping[str, Sequence[Outcome]], scene: str) -> None:
    """Prints one row a policy."""
    table = Table(title=f"Second views, scene {scene}")
    for title in ("policy", "ADD(-S) < 0.1 d", "95 %", "mean ADD(-S)/d", "travel", "n"):
        table.add_column(title, justify="left" if title == "policy" else "right")
    for policy, results in outcomes.items():
        (_, _, recall), (_, _, error), (_, _, travel) = _statistics(results)
        table.add_row(
            policy,
            f"{100 * recall[0]:.1f} %",
            f"{100 * recall[1]:.0f} to {100 * recall[2]:.0f}",
            f"{error[0]:.3f}",
            f"{travel[0]:.2f} m",
            str(len(results)),
        )
    Console().print(table)


Estimate = tuple[float, float, float]


def _statistics(results: Sequence[Outcome]) -> list[tuple[str, str, Estimate]]:
    """Metric, unit and (value, low, high) of each."""
    errors = np.array([result.add_over_diameter for result in results])
    travels = np.array([result.travel for result in results])
    return [
        ("add_s_recall", "1", wilson(int((errors < SUCCESS).sum()), len(errors))),
        ("add_over_diameter", "1", mean_interval(errors)),
        ("travel", "m", mean_interval(travels)),
    ]


def wilson(successes: int, n: int, z: float = 1.959964) -> Estimate:
    """A fraction and its 95 percent interval (Wilson, 1927), which stays within 0 and 1."""
    fraction = successes / n
    centre = (fraction + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(fraction * (1 - fraction) / n + z * z / (4 * n * n))
    return fraction, max(0.0, centre - half), min(1.0, centre + half)


def mean_interval(values: np.ndarray, z: float = 1.959964) -> Estimate:
    """A mean and its 95 percent interval by the normal approximation."""
    mean = float(values.mean())
    half = z * float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else 0.0
    return mean, mean - half, mean + half


def _outcome(info: dict[str, Any], key: str) -> Outcome:
    error = float(info["ground_truth"][key]) / float(info["diameter"])
    return Outcome(str(info["object"]), error, float(info["travel"]))


def _environment_id(config: EvaluateAgentConfig) -> str:
    """The environment to evaluate in; also checks that trained policies know its objects.

    The file of a policy may choose between our own two environments and nothing else: an id that
    names a module would import it.
    """
    ids = set()
    for name in config.policy:
        if name in BASELINES or not os.path.isfile(name):
            continue  # make_policy says what is wrong with it
        from .checkpoint import read_agent

        header, _ = read_agent(name, prefix="policy/")
        ids.add(header.env)
        trained, asked = header.env_kwargs.get("objects") or [], list(config.objects)
        if trained != asked:
            raise ValueError(
                f"policy {name} was trained on {' '.join(trained) or 'all 13 objects'}, not on "
                f"{' '.join(asked) or 'all 13'}: pass "
                + (f"--objects {' '.join(trained)}" if trained else "no --objects")
            )
    if config.env is not None:
        return config.env
    if len(ids) > 1:
        raise ValueError(
            f"the policies were trained on different environments ({', '.join(sorted(ids))}): "
            "evaluate them one environment at a time"
        )
    if not ids <= {BOX_ENV, DISCRETE_ENV}:
        raise ValueError(
            f"the policy was trained on {ids.pop()!r}: name the environment with --env"
        )
    return ids.pop() if ids else BOX_ENV


def _command(config: EvaluateAgentConfig) -> str:
    parts = ["evaluate-agent", "--policy", *config.policy, "--scene", config.scene]
    parts += ["--episodes", str(config.episodes), "--seed", str(config.seed)]
    return shlex.join(parts)
