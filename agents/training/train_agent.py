"""Training an agent with Stable-Baselines3: one command, which may be killed and run again."""

from __future__ import annotations

import functools
import os
import shlex
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from ...core.device import check_device, resolve_device
from ...core.errors import InputError
from ...core.results import write_results
from ..networks.algorithms import ALGORITHMS, GREEDY, POLICY_CLASS
from ..networks.candidates import load_pretrained_extractor
from ..networks.checkpoint import AgentHeader, read_agent, write_agent
from .config import BOX_ENV, DISCRETE_ENV, TrainAgentConfig
from .hyperparameters import algorithm_kwargs, load_hyperparameters
from .sub_environments import has_vector_env, make_sub_environments
from .training_state import counters, restart, restore_state, state_tensors
from .validation import (
    POLICY,
    WORST,
    make_env,
    make_header,
    make_validation,
    record_missing,
    save_policy,
    split_bank,
)

CHECKPOINT, LOGS = "checkpoint.safetensors", "tb"


def train_agent(config: TrainAgentConfig) -> Path:
    """Trains an agent and saves it; resumes from the folder's checkpoint if there is one.

    Args:
        config: see `TrainAgentConfig`.

    Returns:
        The file of the trained policy, for ``evaluate-agent``.

    Raises:
        InputError: if an argument is wrong, there is no such device, or the folder holds a run of
            other arguments.
    """
    check_device(config.device)
    if config.record:
        record_missing(config)
    entry = load_hyperparameters(
        config.algo, config.env_id.rpartition(":")[2], config.hyperparameters
    )
    if config.algo == GREEDY:
        from .train_greedy import train_greedy

        return train_greedy(config, entry)
    steps = config.steps or entry.get("n_timesteps", 0)
    n_envs = config.n_envs or entry.get("n_envs", 1)
    if not all(isinstance(value, int) and value > 0 for value in (steps, n_envs)):
        raise InputError(f"n_timesteps and n_envs must be at least 1, got {steps} and {n_envs}")
    arguments = config.environment_arguments | config.device_argument
    replay = config.bank is not None
    learning, validating = split_bank(config) if replay else ({}, {})
    venv = _environments(config.env_id, arguments | learning, n_envs, replay)
    venv.seed(config.seed)
    try:
        header = make_header(config, entry, venv, n_envs)
        model = _make_model(config, entry, venv)
        if config.pretrained_extractor is not None:
            load_pretrained_extractor(model.policy, config.pretrained_extractor)
        callbacks: list[BaseCallback] = [_Checkpoints(header, config)]
        if replay:
            model.best_mean_reward = WORST  # type: ignore[attr-defined]
            callbacks.append(make_validation(header, config, arguments | validating, n_envs))
        resumed = _resume(model, header, config)
        if resumed:
            print(f"Resuming {config.out} at step {model.num_timesteps} of {steps}.")
        start, began = model.num_timesteps, time.perf_counter()
        if steps > start:
            model.learn(
                steps - start,
                callback=callbacks,
                log_interval=1 if config.algo == "ppo" else 50,
                tb_log_name=config.algo,
                reset_num_timesteps=not resumed,
                progress_bar=config.progress,
            )
        seconds = time.perf_counter() - began
        save_agent(model, header, config.out, policy=not replay)
    finally:
        venv.close()
    _report(model, config, model.num_timesteps - start, seconds)
    return config.out / POLICY


class _Checkpoints(BaseCallback):
    """Saves the trainer between two rollouts, where it is complete, every so many steps."""

    def __init__(self, header: AgentHeader, config: TrainAgentConfig) -> None:
        super().__init__()
        self._header = header
        self._out = config.out
        self._every = config.checkpoint_every
        self._policy = config.bank is None  # else the best one so far is kept
        self._due: int | None = None

    def _on_rollout_start(self) -> None:
        steps = self.model.num_timesteps
        if self._due is not None and steps < self._due:
            return
        if self._due is not None:
            save_agent(self.model, self._header, self._out, policy=self._policy)
        restart(self.model, self._header.seed)
        self._due = (steps // self._every + 1) * self._every

    def _on_step(self) -> bool:
        return True


def save_agent(model: BaseAlgorithm, header: AgentHeader, out: Path, policy: bool = True) -> None:
    """Writes the policy if asked, and the checkpoint from which training can resume."""
    header = replace(header, steps=model.num_timesteps)
    if policy:
        save_policy(model, header, out)
    write_agent(out / CHECKPOINT, replace(header, counters=counters(model)), state_tensors(model))


def _environments(env_id: str, arguments: dict[str, Any], n_envs: int, replay: bool) -> VecEnv:
    """One, or several that share an estimator where there is such a thing, or a process each."""
    if n_envs > 1 and not replay and has_vector_env(env_id):
        return make_sub_environments(env_id, n_envs, arguments)
    return make_vec_env(
        functools.partial(make_env, env_id, arguments),
        n_envs=n_envs,
        vec_env_cls=DummyVecEnv if n_envs == 1 or replay else SubprocVecEnv,
    )


def _make_model(config: TrainAgentConfig, entry: dict[str, Any], venv: VecEnv) -> BaseAlgorithm:
    config.out.mkdir(parents=True, exist_ok=True)
    return ALGORITHMS[config.algo](
        POLICY_CLASS,
        venv,
        seed=config.seed,
        device=resolve_device(config.device),
        tensorboard_log=os.fspath(config.out / LOGS),
        **algorithm_kwargs(entry),
    )


def _resume(model: BaseAlgorithm, header: AgentHeader, config: TrainAgentConfig) -> bool:
    """Restores the folder's checkpoint, if there is one and it is of the same run."""
    path = config.out / CHECKPOINT
    if not (config.resume and path.exists()):
        return False
    found, tensors = read_agent(path)
    names = ("algo", "env", "env_kwargs", "hyperparameters", "n_envs", "seed", "checkpoint_every")
    for name in (*names, "observation_space", "action_space"):
        if getattr(found, name) != getattr(header, name):
            raise InputError(
                f"{path} is of another run: its {name} is {getattr(found, name)}, this one's is "
                f"{getattr(header, name)}; give another folder, or --no-resume to replace it"
            )
    restore_state(model, tensors, found.counters)
    return True


def _report(model: BaseAlgorithm, config: TrainAgentConfig, steps: int, seconds: float) -> None:
    """Prints what was saved and how to evaluate it; writes the results file if one is asked for."""
    policy = config.out / POLICY
    print(f"Saved {policy} after {model.num_timesteps} steps.")
    tags = {"policy": os.fspath(policy), "algo": config.algo, "scene": config.scene}
    records = [{"metric": "steps", "value": model.num_timesteps, "unit": "1", **tags}]
    rewards = [episode["r"] for episode in model.ep_info_buffer or ()]
    if rewards:
        mean, n = sum(rewards) / len(rewards), len(rewards)
        print(f"Mean reward of the last {n} episodes: {mean:.3f}")
        records.append({"metric": "mean_reward", "value": mean, "unit": "1", "n": n, **tags})
    if steps:
        rate = steps / seconds
        records.append({"metric": "steps_per_second", "value": rate, "unit": "1/s", **tags})
    print(f"Learning curves: tensorboard --logdir {config.out / LOGS}")
    print(f"Compare it with the baselines: {_evaluation(config, policy)}")
    if config.json is not None:
        command = f"train-agent --algo {config.algo} --steps {model.num_timesteps}"
        command += f" --out {config.out}"
        write_results(config.json, records, command=command, seed=config.seed)


def _evaluation(config: TrainAgentConfig, policy: Path) -> str:
    """The command that evaluates the policy as it was trained."""
    command = "python -m two_view_pose evaluate-agent --policy random fixed max-baseline"
    command += f" {shlex.quote(os.fspath(policy))}"
    if config.bank is not None:
        return f"{command} --bank {shlex.quote(os.fspath(config.bank))}"
    command += f" --scene {config.scene}"
    if config.objects:
        command += f" --objects {shlex.join(config.objects)}"
    if config.env_id not in (BOX_ENV, DISCRETE_ENV):
        command += f" --env {config.env_id}"
    return command
