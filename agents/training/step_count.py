"""How many environment steps a training takes: Stable-Baselines3 plays whole rollouts."""

import math

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from ...core.errors import InputError


def check_steps(model: BaseAlgorithm, algo: str, steps: int) -> None:
    """Says how many steps are played if not the number asked for.

    Args:
        model: of the run, with the steps it has already played.
        algo: its name.
        steps: number of environment steps asked for, including those already played.

    Raises:
        InputError: if nothing would be learned in so few steps.
    """
    if isinstance(model, OffPolicyAlgorithm) and steps <= model.learning_starts:
        raise InputError(
            f"steps must be > {model.learning_starts}, since {algo} learns nothing before (its "
            f"hyper-parameter learning_starts), got {steps}"
        )
    if not isinstance(model, OnPolicyAlgorithm):
        return
    rollout = model.n_steps * model.n_envs
    missing = steps - model.num_timesteps
    if missing > 0 and missing % rollout:
        total = model.num_timesteps + math.ceil(missing / rollout) * rollout
        print(
            f"{algo} plays whole rollouts of {rollout} steps (n_steps {model.n_steps} in each of "
            f"{model.n_envs} environments): {total} steps instead of {steps}."
        )
