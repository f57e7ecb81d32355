"""Training over a bank: splits off validation scenes and keeps the best policy."""

import functools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecTransposeImage

from ...core.errors import InputError
from ..networks.checkpoint import AgentHeader, describe_space, write_agent
from .config import TrainAgentConfig

POLICY = "policy.safetensors"

MIN_REWARD = -1e9
"""Lower than any mean reward."""


def record_missing(config: TrainAgentConfig) -> None:
    """Records the banks of the configuration that do not exist."""
    from ...envs.recording.config import RecordBankConfig
    from ...envs.recording.record_bank import record_bank

    for path, scenes, seed, estimates in (
        (config.bank, 600, 101, True),
        (config.visibility_bank, 1500, 303, False),
    ):
        if path is not None and not path.exists():
            settings: dict[str, Any] = {"scenes": scenes, "seed": seed, "estimates": estimates}
            record_bank(RecordBankConfig(out=path, device=config.device, **settings))


def split_bank(config: TrainAgentConfig) -> tuple[dict[str, Any], dict[str, Any]]:
    """Arguments of the replay environment for training and for validation.

    Raises InputError if there is no such bank, or it has too few scenes.
    """
    from ...envs.replay import load_bank_cached

    assert config.bank is not None
    scenes = len(load_bank_cached(str(config.bank)))
    if scenes <= config.validation:
        raise InputError(
            f"validation must be < {scenes}, the scenes of {config.bank}, got {config.validation}"
        )
    split = scenes - config.validation
    return {"scenes": (0, split), "mirror": True}, {"scenes": (split, scenes), "shuffle": False}


class ValidationCallback(EvalCallback):
    """Validates the policy and writes the best one, whose reward is stored in the model."""

    model: Any

    def __init__(
        self, header: AgentHeader, config: TrainAgentConfig, arguments: dict[str, Any], n_envs: int
    ) -> None:
        make = functools.partial(make_env, config.env_id, arguments)
        venv = make_vec_env(make, n_envs=1, seed=config.seed, vec_env_cls=DummyVecEnv)
        super().__init__(
            VecTransposeImage(venv),
            n_eval_episodes=config.validation,
            eval_freq=max(1, config.evaluate_every // n_envs),
            verbose=0,
        )
        self._header, self._out = header, config.out

    def _init_callback(self) -> None:
        super()._init_callback()
        self.best_mean_reward = self.model.best_mean_reward
        # A resumed run validates at the steps of an uninterrupted one.
        self.n_calls = self.model.num_timesteps // self.training_env.num_envs

    def _on_step(self) -> bool:
        result = super()._on_step()
        if self.best_mean_reward > self.model.best_mean_reward:
            self.model.best_mean_reward = self.best_mean_reward
            save_policy(self.model, self._header, self._out)
        return result

    def _on_training_end(self) -> None:
        """Validates the last policy too: it may be the best, and of a short run the only one."""
        self.eval_freq = self.n_calls
        self._on_step()


def save_policy(model: BaseAlgorithm, header: AgentHeader, out: Path) -> None:
    """Writes the current policy into ``out``."""
    weights = {f"policy/{key}": value for key, value in model.policy.state_dict().items()}
    write_agent(out / POLICY, replace(header, steps=model.num_timesteps), weights, half=True)


def make_header(
    config: TrainAgentConfig,
    hyperparameters: dict[str, Any],
    env: gym.Env | VecEnv,
    n_envs: int = 1,
    steps: int = 0,
) -> AgentHeader:
    """Makes the header of an agent file; raises InputError if ``env_kwargs`` is not plain data."""
    arguments = config.environment_arguments
    try:
        env_kwargs = json.loads(json.dumps(arguments))
    except TypeError as error:
        raise InputError(f"env_kwargs must be plain data, got {arguments}: {error}") from error
    return AgentHeader(
        algo=config.algo,
        env=config.env_id,
        env_kwargs=env_kwargs,
        hyperparameters=hyperparameters,
        n_envs=n_envs,
        seed=config.seed,
        checkpoint_every=config.checkpoint_every,
        steps=steps,
        observation_space=describe_space(env.observation_space),
        action_space=describe_space(env.action_space),
    )


def make_env(env_id: str, arguments: dict[str, Any]) -> gym.Env:
    """Makes the environment; unpickling this function in a worker process registers our ids."""
    return gym.make(env_id, **arguments)
