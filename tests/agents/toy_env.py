"""A one-step environment of the same kinds of spaces as the real one, solved in seconds.

The picture is dark or bright, ``camera`` says where to look: the reward is highest when the action's
azimuth follows the camera's number and its elevation the picture.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 36


class ToyViewEnv(gym.Env):
    """Look where the observation says."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, scene: str = "linemod", estimator: object = None, gain: float = 1.0) -> None:
        self.gain = gain
        self.observation_space = spaces.Dict(
            {
                "camera": spaces.Box(-1.0, 1.0, (2,), np.float32),
                "object": spaces.Box(0.0, 1.0, (3,), np.float32),
                "image": spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8),
            }
        )
        self.action_space: spaces.Space = spaces.Box(-1.0, 1.0, (3,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        super().reset(seed=seed)
        self._wanted = self.np_random.uniform(-1.0, 1.0, 2)
        one_hot = np.zeros(3, np.float32)
        one_hot[self.np_random.integers(3)] = 1.0
        observation = {
            "camera": self._wanted.astype(np.float32),
            "object": one_hot,
            "image": np.full((SIZE, SIZE, 3), 128 + 100 * self._wanted[1], np.uint8),
        }
        return observation, {}

    def _direction(self, action: Any) -> np.ndarray:
        return np.asarray(action, dtype=np.float64)[:2]

    def step(
        self, action: Any
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        reward = -self.gain * float(np.abs(self._direction(action) - self._wanted).mean())
        observation, _ = self.reset()
        return observation, reward, True, False, {}


class ToyViewDiscreteEnv(ToyViewEnv):
    """The same with four directions."""

    def __init__(self, scene: str = "linemod", estimator: object = None, gain: float = 1.0) -> None:
        super().__init__(scene, estimator, gain)
        self.action_space = spaces.Discrete(4)

    def _direction(self, action: Any) -> np.ndarray:
        return np.array([-0.5 + int(action) % 2, -0.5 + int(action) // 2])


gym.register("ToyView-v0", entry_point=ToyViewEnv)
gym.register("ToyViewDiscrete-v0", entry_point=ToyViewDiscreteEnv)
