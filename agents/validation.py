"""Training over a bank: which scenes are learned from, and keeping the best policy."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecTransposeImage

from .checkpoint import AgentHeader, write_agent
from .config import TrainAgentConfig

POLICY = "policy.safetensors"

WORST = -1e9
"""Less than any mean reward."""


def record_missing(config: TrainAgentConfig) -> None:
    """Records the banks of the configuration that do not exist."""
    from ..envs.record_bank import record_bank
    from ..envs.record_config import RecordBankConfig

    if config.bank is not None and not config.bank.exists():
        record_bank(RecordBankConfig(out=config.bank, scenes=1000, seed=101, device=config.device))
    if config.more_scenes is not None and not config.more_scenes.exists():
        record_bank(
            RecordBankConfig(
                out=config.more_scenes, scenes=2500, seed=303, estimates=False, device=config.device
            )
        )


def split_bank(config: TrainAgentConfig) -> tuple[dict[str, Any], dict[str, Any]]:
    """Arguments of the replay environment for learning and for validation.

    Raises:
        ValueError: if there is no such bank, or it has too few scenes.
    """
    from ..envs.replay import load_bank_cached

    assert config.bank is not None
    scenes = len(load_bank_cached(str(config.bank)))
    if scenes <= config.validation:
        raise ValueError(
            f"{config.bank} has {scenes} scenes: too few to keep {config.validation} for "
            "validation; record more, or pass a smaller --validation"
        )
    kept = scenes - config.validation
    return {"scenes": (0, kept), "mirror": True}, {"scenes": (kept, scenes), "shuffle": False}


class _Best(BaseCallback):
    """Writes the policy that has just been found the best one."""

    def __init__(self, header: AgentHeader, out: Path) -> None:
        super().__init__()
        self._header, self._out = header, out

    def _on_step(self) -> bool:
        assert isinstance(self.parent, EvalCallback)
        self.model.best_mean_reward = float(self.parent.best_mean_reward)  # type: ignore[attr-defined]
        save_policy(self.model, self._header, self._out)
        return True


class _Validation(EvalCallback):
    """SB3's, which also knows what an earlier part of the run has reached."""

    def _init_callback(self) -> None:
        super()._init_callback()
        self.best_mean_reward = self.model.best_mean_reward  # type: ignore[attr-defined]


def make_validation(
    header: AgentHeader, config: TrainAgentConfig, arguments: dict[str, Any], n_envs: int
) -> EvalCallback:
    """Measures the policy on the validation scenes, and keeps the best one."""
    make = functools.partial(make_env, config.env_id, arguments)
    return _Validation(
        VecTransposeImage(make_vec_env(make, n_envs=1, seed=config.seed, vec_env_cls=DummyVecEnv)),
        callback_on_new_best=_Best(header, config.out),
        n_eval_episodes=config.validation,
        eval_freq=max(1, config.evaluate_every // n_envs),
        deterministic=True,
        verbose=0,
    )


def save_policy(model: BaseAlgorithm, header: AgentHeader, out: Path) -> None:
    """Writes the policy as it is now into ``out``."""
    weights = {f"policy/{key}": value for key, value in model.policy.state_dict().items()}
    write_agent(out / POLICY, replace(header, steps=model.num_timesteps), weights, half=True)


def make_env(env_id: str, arguments: dict[str, Any]) -> gym.Env:
    """Makes the environment in whichever process this runs; unpickling it registers the ids."""
    return gym.make(env_id, **arguments)
