"""``train-agent --algo greedy``: trains on a bank and writes the agent file."""

import os
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from ...core.device import resolve_device
from ...core.results import write_results
from ...envs.view_banks.bank import ViewBank, read_bank
from ..networks.algorithms import GREEDY, GreedyHyperparameters
from ..networks.checkpoint import write_agent
from ..policies.trained import channels_first
from .config import TrainAgentConfig
from .error_regression import predicted_best_slots, train_greedy_agent
from .validation import POLICY, make_header, split_bank


def train_greedy(config: TrainAgentConfig, entry: dict[str, Any]) -> Path:
    """Trains an agent with the hyper-parameters ``entry`` and prints its validation results.

    It takes minutes, so it does not resume: the same command starts again and ends the same.

    Returns:
        The file of the trained policy.
    """
    hyperparameters = GreedyHyperparameters(**entry)
    training, validation = split_bank(config)
    env = gym.make(config.env_id, **config.environment_arguments)
    bank: ViewBank = env.unwrapped.bank  # type: ignore[attr-defined]
    start = time.perf_counter()
    agent = train_greedy_agent(
        bank.subset(slice(*training["scenes"])),
        channels_first(env),
        hyperparameters,
        config.seed,
        config.progress,
        None if config.visibility_bank is None else read_bank(config.visibility_bank),
        resolve_device(config.device),
    )
    seconds = time.perf_counter() - start
    steps = hyperparameters.epochs * hyperparameters.networks
    header = make_header(config, vars(hyperparameters), env, steps=steps)
    weights = {f"policy/{key}": value for key, value in agent.state_dict().items()}
    path = config.out / POLICY
    write_agent(path, header, weights, half=True)
    held_out = bank.subset(slice(*validation["scenes"]))
    slots = predicted_best_slots(agent, held_out)
    errors = held_out.second_error[np.arange(len(held_out)), slots]
    recall, capped = float(np.mean(errors < 0.1)), float(np.minimum(errors, 1.0).mean())
    print(f"Saved {path} after {seconds:.0f} s.")
    print(f"Validation, {len(held_out)} scenes: ADD(-S) < 0.1 d {recall:.1%}, ", end="")
    print(f"mean capped error {capped:.3f}")
    if config.json is not None:
        tags: dict[str, Any] = {"policy": os.fspath(path), "algo": GREEDY, "n": len(held_out)}
        tags["scene"] = bank.header.scene
        records = [
            {"metric": "add_s_recall", "value": recall, "unit": "1", **tags},
            {"metric": "capped_add_over_diameter", "value": capped, "unit": "1", **tags},
            {"metric": "training_time", "value": seconds, "unit": "s", **tags},
        ]
        command = f"train-agent --algo greedy --bank {config.bank} --out {config.out}"
        if config.visibility_bank is not None:
            command += f" --visibility-bank {config.visibility_bank}"
        write_results(config.json, records, command=command, seed=config.seed)
    return path
