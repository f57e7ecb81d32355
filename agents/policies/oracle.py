"""``oracle``: simulates every view and takes the best one; an upper bound."""

from collections.abc import Mapping

import gymnasium as gym
import numpy as np

from ...core.errors import InputError
from .baselines import ViewSpherePolicy
from .view_sphere import Action, candidate_actions


class OraclePolicy(ViewSpherePolicy):
    """Takes the candidate with the smallest true error, which ``simulate_actions`` gives."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        if not hasattr(self._env, "simulate_actions"):
            raise InputError(f"oracle needs an env with simulate_actions(), got {self._env}")

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """Returns the best candidate; in a Box those of ``TwoViewPoseDiscrete-v0``."""
        actions = candidate_actions(self._env)
        outputs = self._env.simulate_actions(actions)
        errors = [info["ground_truth"]["add_second"] for *_, info in outputs]
        return actions[int(np.argmin(errors))]
