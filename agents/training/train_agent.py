"""Resumable training of an agent with Stable-Baselines3."""

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
from .step_count import check_steps
from .sub_environments import has_vector_env, make_sub_environments
from .training_state import counters, reseed, restore_state, state_tensors
from .validation import (
    MIN_REWARD,
    POLICY,
    ValidationCallback,
    make_env,
    make_header,
    record_missing,
    save_policy,
    split_bank,
)

CHECKPOINT, LOGS = "checkpoint.safetensors", "tb"


def train_agent(config: TrainAgentConfig) -> Path:
    """Trains and saves an agent; resumes from the folder's checkpoint if there is one.

    Returns:
        The file of the trained policy, for ``evaluate-agent``.

    Raises:
        InputError: if an argument is wrong, there is no such device, or the folder holds a run with
            other arguments.
    """
    check_device(config.device)
    if config.record:
        record_missing(config)
    env_id = config.env_id.rpartition(":")[2]
    entry = load_hyperparameters(config.algo, env_id, config.hyperparameters)
    if config.algo == GREEDY:
        from .train_greedy import train_greedy

        return train_greedy(config, entry)
    steps = config.steps or entry.get("n_timesteps", 0)
    n_envs = config.n_envs or entry.get("n_envs", 1)
    if not all(isinstance(value, int) and value > 0 for value in (steps, n_envs)):
        raise InputError(f"n_timesteps and n_envs must be >= 1, got {steps} and {n_envs}")
    arguments = config.environment_arguments | config.device_argument
    replay = config.bank is not None
    training, validation = split_bank(config) if replay else ({}, {})
    venv = _make_venv(config.env_id, arguments | training, n_envs, replay)
    venv.seed(config.seed)
    try:
        header = make_header(config, entry, venv, n_envs)
        model = _make_model(config, entry, venv)
        if config.pretrained_extractor is not None:
            load_pretrained_extractor(model.policy, config.pretrained_extractor)
        callbacks: list[BaseCallback] = [_Checkpoints(header, config)]
        if replay:
            model.best_mean_reward = MIN_REWARD  # type: ignore[attr-defined]
            callbacks.append(ValidationCallback(header, config, arguments | validation, n_envs))
        resumed = _resume(model, header, config)
        if resumed:
            print(f"Resuming {config.out} at step {model.num_timesteps} of {steps}.")
        first_step, start = model.num_timesteps, time.perf_counter()
        check_steps(model, config.algo, steps)
        if steps > first_step:
            model.learn(
                steps - first_step,
                callback=callbacks,
                log_interval=1 if config.algo == "ppo" else 50,
                tb_log_name=config.algo,
                reset_num_timesteps=not resumed,
                progress_bar=config.progress,
            )
        seconds = time.perf_counter() - start
        missing = not (config.out / POLICY).exists()
        if missing and replay:
            print(f"{config.out / POLICY} was missing: this is the last policy, not the best.")
        save_agent(model, header, config.out, policy=missing or not replay)
    finally:
        venv.close()
    _report(model, config, model.num_timesteps - first_step, seconds)
    return config.out / POLICY


class _Checkpoints(BaseCallback):
    """Saves the trainer at regular steps, between two rollouts."""

    def __init__(self, header: AgentHeader, config: TrainAgentConfig) -> None:
        super().__init__()
        self._header, self._out = header, config.out
        self._policy = config.bank is None  # with a bank the best one is kept instead
        self._next_steps = 0

    def _on_rollout_start(self) -> None:
        steps, every = self.model.num_timesteps, self._header.checkpoint_every
        if steps < self._next_steps:
            return
        if self._next_steps:
            save_agent(self.model, self._header, self._out, policy=self._policy)
        reseed(self.model, self._header.seed)
        self._next_steps = (steps // every + 1) * every

    def _on_step(self) -> bool:
        return True


def save_agent(model: BaseAlgorithm, header: AgentHeader, out: Path, policy: bool = True) -> None:
    """Writes the checkpoint, and the policy if asked."""
    header = replace(header, steps=model.num_timesteps)
    if policy:
        save_policy(model, header, out)
    write_agent(out / CHECKPOINT, replace(header, counters=counters(model)), state_tensors(model))


def _make_venv(env_id: str, arguments: dict[str, Any], n_envs: int, replay: bool) -> VecEnv:
    """Several environments share an estimator if possible, else each has a process."""
    if n_envs > 1 and not replay and has_vector_env(env_id):
        return make_sub_environments(env_id, n_envs, arguments)
    vec_env_cls = DummyVecEnv if n_envs == 1 or replay else SubprocVecEnv
    make = functools.partial(make_env, env_id, arguments)
    return make_vec_env(make, n_envs=n_envs, vec_env_cls=vec_env_cls)


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
    """Restores the folder's checkpoint, if there is one."""
    path = config.out / CHECKPOINT
    if not (config.resume and path.exists()):
        return False
    found, tensors = read_agent(path)
    names = ("algo", "env", "env_kwargs", "hyperparameters", "n_envs", "seed", "checkpoint_every")
    for name in (*names, "observation_space", "action_space"):
        theirs, ours = getattr(found, name), getattr(header, name)
        if theirs != ours:
            raise InputError(
                f"{path} is of another run: its {name} is {theirs}, this one's is {ours}; "
                "pass another --out, or --no-resume to replace it"
            )
    restore_state(model, tensors, found.counters, str(path))
    return True


def _report(model: BaseAlgorithm, config: TrainAgentConfig, steps: int, seconds: float) -> None:
    """Prints the results and the command to evaluate them; writes the results file if asked."""
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
        rate = {"metric": "steps_per_second", "value": steps / seconds, "unit": "1/s"}
        records.append(rate | tags)
    print(f"Learning curves: tensorboard --logdir {config.out / LOGS}")
    print(f"Compare it with the baselines: {_evaluation_command(config, policy)}")
    if config.json is not None:
        options = f"--algo {config.algo} --steps {model.num_timesteps} --out {config.out}"
        write_results(config.json, records, command=f"train-agent {options}", seed=config.seed)


def _evaluation_command(config: TrainAgentConfig, policy: Path) -> str:
    """The command that evaluates the policy in its training environment."""
    command = "python -m two_view_pose evaluate-agent --policy random fixed max-baseline"
    command += f" {shlex.quote(os.fspath(policy))}"
    if config.bank is not None:
        return f"{command} --bank {shlex.quote(os.fspath(config.bank))}"
    command += f" --scene {config.scene}"
    if config.objects:
        command += f" --objects {shlex.join(config.objects)}"
    if config.unit != "auto":
        command += f" --unit {config.unit}"
    if config.env_id not in (BOX_ENV, DISCRETE_ENV):
        command += f" --env {config.env_id}"
    return command
