"""Evaluates policies on the same scenes."""

import os
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from ...core.device import check_device
from ...core.errors import InputError
from ...core.results import write_results
from ...envs.episode import episode_seed
from ...envs.view_banks.bank import ViewBank
from ..networks.checkpoint import AgentHeader, read_agent
from ..policies.baselines import Policy
from ..policies.registry import agent_file, make_policy
from ..training.config import BOX_ENV, DISCRETE_ENV, REPLAY_ENV, EvaluateAgentConfig
from .outcomes import STAY, Outcome, make_records, outcome_of, print_table

Scenes = Sequence[tuple[dict[str, Any], np.random.SeedSequence]]
"""For each episode the arguments of ``reset``, and the seed of the policies' random choices."""

EPISODES = 100
"""Default number of rendered scenes."""


def evaluate_agents(config: EvaluateAgentConfig) -> list[dict[str, Any]]:
    """Runs policies on the same scenes, prints a table, and writes results and figures if asked.

    Returns:
        The records of the results file, see `make_records`; always including ``stay``.

    Raises:
        InputError: if an argument is wrong, there is no such device, or a file is not an agent for
            this environment.
    """
    check_device(config.device)
    outcomes: dict[str, list[Outcome]] = {}
    bank: ViewBank | None = None
    for env_id, names in policies_by_environment(config).items():
        env = _make_environment(config, env_id)
        try:
            policies = {name: make_policy(name, env, config.device) for name in names}
            bank = None if config.bank is None else env.unwrapped.bank  # type: ignore[attr-defined]
            group: dict[str, list[Outcome]] = {}
            for seed in range(config.seed, config.seed + config.seeds):
                scenes = _scenes(config, bank, seed)
                for name, results in run_episodes(env, policies, scenes, config.progress).items():
                    group.setdefault(name, []).extend(results)
        finally:
            env.close()
        outcomes = group | outcomes
    outcomes = {name: outcomes[name] for name in dict.fromkeys((STAY, *config.policy))}
    scene = config.scene if bank is None else str(bank.header.scene)
    print_table(outcomes, _title(config, scene, bank))
    records = make_records(outcomes, scene)
    if config.json is not None:
        write_results(config.json, records, command=_command(config), seed=config.seed)
    if config.figures is not None:
        from .figures import draw_figures

        for path in draw_figures(config.figures, outcomes, bank):
            print(f"figure {path}")
    return records


def seeded_scenes(episodes: int, seed: int) -> Scenes:
    """Seeds of a number of random scenes."""
    return [
        ({"seed": episode_seed(seed, i)}, np.random.SeedSequence(seed, spawn_key=(i,)))
        for i in range(episodes)
    ]


def run_episodes(
    env: gym.Env, policies: Mapping[str, Policy], scenes: Scenes, progress: bool = False
) -> dict[str, list[Outcome]]:
    """Runs every policy on the same scenes, independently of the other policies.

    Args:
        env: an environment whose info has ``object``, ``diameter``, ``travel`` and, under
            ``ground_truth``, ``add_first`` and ``add_second``.
        policies: the policies by name.
        scenes: see `seeded_scenes`.
        progress: show a progress bar.

    Returns:
        One outcome per scene for each policy, in the same order, and for ``stay``.

    Raises:
        InputError: if the environment has no estimator.
    """
    moving = {name: policy for name, policy in policies.items() if name != STAY}
    outcomes: dict[str, list[Outcome]] = {name: [] for name in (STAY, *moving)}
    bar = tqdm(total=len(scenes) * max(1, len(moving)), unit="episode", disable=not progress)
    for arguments, sequence in scenes:
        first, info = env.reset(**arguments)
        if "add_first" not in info["ground_truth"]:
            raise InputError("estimator must not be None to evaluate poses")
        outcomes[STAY].append(outcome_of(info, "add_first", 0))
        for i, (name, policy) in enumerate(moving.items()):
            observation = first if i == 0 else env.reset(**arguments)[0]
            outcomes[name].append(_run_episode(env, policy, observation, sequence))
            bar.update()
    bar.close()
    return outcomes


def _run_episode(
    env: gym.Env, policy: Policy, observation: Any, sequence: np.random.SeedSequence
) -> Outcome:
    """Runs an episode from its first observation."""
    policy.reset(np.random.default_rng(sequence))
    done, info = False, dict[str, Any]()
    while not done:
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        done = terminated or truncated
    return outcome_of(info, "add_second", int(info.get("second_views", 1)))


def _scenes(config: EvaluateAgentConfig, bank: ViewBank | None, seed: int) -> Scenes:
    if bank is None:
        return seeded_scenes(config.episodes or EPISODES, seed)
    if (config.episodes or 0) > len(bank):
        raise InputError(f"episodes must be at most {len(bank)}, the scenes of {config.bank}")
    return [
        ({"options": {"scene": i}}, np.random.SeedSequence(seed, spawn_key=(i,)))
        for i in range(config.episodes or len(bank))
    ]


def policies_by_environment(config: EvaluateAgentConfig) -> dict[str, list[str]]:
    """Groups policies by environment id; all see the same scenes.

    A trained policy acts in its training environment, the baselines in the first of these. A policy
    file can only select our own environments, since an id with a module name would import it.
    """
    env_ids: dict[str, str] = {}
    for name in config.policy:
        path = agent_file(name)
        if path is not None:
            header, _ = read_agent(path, prefix="policy/")
            _check_objects(name, header, config)
            env_ids[name] = config.env or _live_environment(header)
    default = DISCRETE_ENV if config.bank is not None else BOX_ENV
    first = config.env or next(iter(env_ids.values()), default)
    groups: dict[str, list[str]] = {}
    for name in sorted(config.policy, key=lambda name: name in env_ids):
        groups.setdefault(env_ids.get(name, first), []).append(name)
    return groups


def _live_environment(header: AgentHeader) -> str:
    """The rendering environment of an agent."""
    if header.env in (REPLAY_ENV, f"two_view_pose:{REPLAY_ENV}"):
        return BOX_ENV if str(header.action_space).startswith("Box") else DISCRETE_ENV
    if header.env not in (BOX_ENV, DISCRETE_ENV):
        raise InputError(f"the policy was trained on {header.env!r}: pass --env")
    return header.env


def _check_objects(name: str, header: AgentHeader, config: EvaluateAgentConfig) -> None:
    trained, asked = header.env_kwargs.get("objects") or [], list(config.objects)
    if trained != asked and config.bank is None:
        raise InputError(
            f"policy {name} was trained on {' '.join(trained) or 'all 13 objects'}, not on "
            f"{' '.join(asked) or 'all 13'}: pass the same --objects"
        )
    unit = header.env_kwargs.get("unit", "auto")
    if unit != config.unit and config.bank is None:
        raise InputError(
            f"policy {name} was trained with meshes read in the unit {unit}: pass --unit {unit}"
        )


def _make_environment(config: EvaluateAgentConfig, env_id: str) -> gym.Env:
    if config.bank is None:
        return gym.make(env_id, **config.environment_arguments)
    action = "box" if env_id == BOX_ENV else "discrete"
    return gym.make(REPLAY_ENV, bank=os.fspath(config.bank), action=action, **config.env_kwargs)


def _title(config: EvaluateAgentConfig, scene: str, bank: ViewBank | None) -> str:
    if bank is None:
        return f"Second views, scene {scene}"
    source = "recorded views" if bank.header.source == "simulation" else bank.header.source
    return f"Second views, {source}, {scene} ({os.fspath(config.bank or '')})"


def _command(config: EvaluateAgentConfig) -> str:
    live = config.bank is None
    options = {
        "--scene": config.scene if live else None,
        "--bank": config.bank,
        "--episodes": config.episodes or (EPISODES if live else None),
        "--seed": config.seed,
        "--seeds": config.seeds if config.seeds > 1 else None,
    }
    given = [str(part) for option in options.items() if option[1] is not None for part in option]
    return shlex.join(["evaluate-agent", "--policy", *config.policy, *given])
