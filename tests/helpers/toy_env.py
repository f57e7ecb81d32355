"""Toy environments with the spaces of the real ones, without rendering.

``ToyView-v0``: the reward is highest if the action's first two numbers equal ``camera``, whose
second number is also the image's brightness. ``ToySphere-v0``: the real view sphere and info, with
a synthetic error that decreases with the angle between the views.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from two_view_pose.envs.observation import SpherePosition
from two_view_pose.envs.simulation.camera import CAMERA_RANGE
from two_view_pose.envs.simulation.carrier import camera_center
from two_view_pose.envs.two_view_pose import CANDIDATE_VIEWS, TwoViewPoseDiscreteEnv, TwoViewPoseEnv

SIZE = 36


class ToyViewEnv(gym.Env):
    """The optimal action is in the observation."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        scene: str = "linemod",
        estimator: object = None,
        gain: float = 1.0,
        device: str = "auto",
    ) -> None:
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
        self._target = self.np_random.uniform(-1.0, 1.0, 2)
        one_hot = np.zeros(3, np.float32)
        one_hot[self.np_random.integers(3)] = 1.0
        observation = {
            "camera": self._target.astype(np.float32),
            "object": one_hot,
            "image": np.full((SIZE, SIZE, 3), 128 + 100 * self._target[1], np.uint8),
        }
        return observation, {}

    def _direction(self, action: Any) -> np.ndarray:
        return np.asarray(action, dtype=np.float64)[:2]

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        reward = -self.gain * float(np.abs(self._direction(action) - self._target).mean())
        observation, _ = self.reset()
        return observation, reward, True, False, {}


class ToyViewDiscreteEnv(ToyViewEnv):
    """ToyView with four actions."""

    def __init__(self, scene: str = "linemod", estimator: object = None, gain: float = 1.0) -> None:
        super().__init__(scene, estimator, gain)
        self.action_space = spaces.Discrete(4)

    def _direction(self, action: Any) -> np.ndarray:
        return np.array([-0.5 + int(action) % 2, -0.5 + int(action) // 2])


class ToySphereEnv(ToyViewEnv):
    """Choose a view around an object at a known position."""

    camera_pose = TwoViewPoseEnv.camera_pose

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        observation, _ = super().reset(seed=seed)
        self.sphere_center = self.np_random.uniform((-0.3, -0.3, 0.0), (0.3, 0.3, 0.1))
        self.reference_position = SpherePosition(
            distance=float(self.np_random.uniform(*CAMERA_RANGE.distance)),
            azimuth=float(self.np_random.uniform(-np.pi, np.pi)),
            elevation=float(self.np_random.uniform(*CAMERA_RANGE.elevation)),
            roll=0.0,
        )
        self._first = float(self.np_random.uniform(0.0, 0.05))
        self._name = ("cat", "duck")[int(self.np_random.integers(2))]
        return observation, self._info(travel=0.0, add_first=self._first)

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        angle = self.angle(self.camera_pose(action))
        info = self._info(angle, add_first=self._first, add_second=self._first * np.cos(angle / 2))
        return super().reset()[0], 0.0, True, False, info

    def angle(self, T_cam_world: np.ndarray) -> float:
        """Angle in radians between the reference view's direction and another's."""
        place = self.reference_position
        azimuth, elevation = place.azimuth, place.elevation
        direction = camera_center(T_cam_world) - self.sphere_center
        reference = np.array(
            [
                np.cos(azimuth) * np.cos(elevation),
                np.sin(azimuth) * np.cos(elevation),
                np.sin(elevation),
            ]
        )
        cosine = reference @ direction / np.linalg.norm(direction)
        return float(np.arccos(np.clip(cosine, -1, 1)))

    def _info(self, travel: float, **errors: float) -> dict[str, Any]:
        return {
            "object": self._name,
            "diameter": 0.1,
            "travel": travel,
            "ground_truth": errors if self.gain else {},
        }


class ToySphereDiscreteEnv(ToySphereEnv):
    """ToySphere with the real environment's candidate views."""

    camera_pose = TwoViewPoseDiscreteEnv.camera_pose

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._candidates = np.deg2rad(CANDIDATE_VIEWS)
        self.action_space = spaces.Discrete(len(CANDIDATE_VIEWS))


gym.register("ToyView-v0", entry_point=ToyViewEnv)
gym.register("ToyViewDiscrete-v0", entry_point=ToyViewDiscreteEnv)
gym.register("ToySphere-v0", entry_point=ToySphereEnv)
gym.register("ToySphereDiscrete-v0", entry_point=ToySphereDiscreteEnv)
