"""Two-View Pose over recorded views, without rendering and estimation."""

import os
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from ..core.errors import InputError
from ..core.validation import require_within
from ..pose_estimator.types import PoseEstimate
from .actions import box_view, candidate_view, check_candidates
from .copying import CopyableEnv
from .episode import ground_truth
from .observation import Observation, SpherePosition, observation_space
from .simulation.camera import view_sphere_pose
from .simulation.carrier import angle_at, camera_center
from .view_banks.bank import ViewBank, read_bank
from .view_banks.mirror import Mirror

_RADIANS_PER_METER = np.deg2rad(60.0)
"""Weight of the distance against the angle when a Box action is matched to a recorded view."""


class TwoViewPoseReplayEnv(CopyableEnv, gym.Env[Observation, Any]):
    """`TwoViewPoseDiscrete-v0` (or `TwoViewPose-v0`) over a bank that `record-bank` wrote.

    ## Description

    The same observations, actions, rewards and infos as in the live environments, at thousands of
    steps a second, from the recorded outcome of every candidate view. A bank holds simulated scenes
    or real photographs, so a policy trained in simulation can be evaluated on photographs.

    ```python
    env = gym.make("two_view_pose:TwoViewPoseReplay-v0", bank="bank.npz")
    ```

    ## Action Space

    With `action="discrete"`, that of `TwoViewPoseDiscrete-v0`: the index of a candidate view. With
    `action="box"`, that of `TwoViewPose-v0`; it takes the recorded view that is nearest in
    direction and distance.

    ## Starting State

    A random scene of the bank; `reset(options={"scene": 17})` chooses one.

    ## Arguments

    | Argument        | Default      | Meaning                                                    |
    |-----------------|--------------|------------------------------------------------------------|
    | `bank`          |              | a file, or a `ViewBank`                                    |
    | `action`        | `"discrete"` | or `"box"`                                                 |
    | `travel_weight` | 0.05         | cost of a meter of camera travel                           |
    | `scenes`        | None         | (first, end): only these scenes of the bank                |
    | `mirror`        | False        | flip scenes left to right with probability 0.5             |
    | `shuffle`       | True         | sample scenes at random; False: in the bank's order        |

    ## Version History

    * v0: first release
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (declared so by Gymnasium)

    def __init__(
        self,
        *,
        bank: str | os.PathLike[str] | ViewBank,
        action: Literal["discrete", "box"] = "discrete",
        travel_weight: float = 0.05,
        scenes: tuple[int, int] | None = None,
        mirror: bool = False,
        shuffle: bool = True,
        render_mode: str | None = None,
    ) -> None:
        if action not in ("discrete", "box"):
            raise InputError(f"action must be discrete or box, got {action!r}")
        self.travel_weight = float(travel_weight)
        require_within(self, 0, np.inf, "travel_weight")
        self.render_mode = render_mode
        self.bank = bank if isinstance(bank, ViewBank) else load_bank_cached(os.fspath(bank))
        if not self.bank.has_estimates:
            raise InputError(
                "bank has no estimates of second views (it was recorded with --no-estimates): "
                "it can only train agents with --algo greedy --visibility-bank"
            )
        first, end = (0, len(self.bank)) if scenes is None else scenes
        if not 0 <= first < end <= len(self.bank):
            raise InputError(f"scenes must lie within 0 to {len(self.bank)}, got {scenes}")
        self._scenes = range(first, end)
        self._shuffle, self._next = shuffle, 0
        self.object_names = self.bank.header.object_names
        self._candidates = check_candidates(self.bank.header.candidate_views)
        self._mirror = Mirror(self._candidates) if mirror else None
        space = observation_space(len(self.object_names), self.bank.first["image"].shape[1])
        self.observation_space: spaces.Space[Any] = space
        self.action_space: spaces.Space[Any] = spaces.Box(-1.0, 1.0, (3,), np.float32)
        if action == "discrete":
            self.action_space = spaces.Discrete(self.bank.slots)
        self._scene: int | None = None
        self._mirrored = self._ended = False

    @property
    def scene(self) -> int:
        """Index of the episode's scene in the bank."""
        if self._scene is None:
            raise ResetNeeded("there is no episode: call reset() first")
        return self._scene

    @property
    def estimate(self) -> PoseEstimate:
        """The estimate from the reference view."""
        bank, i = self.bank, self.scene
        return PoseEstimate(
            T_cam_obj=bank.T_cam_obj[i].copy(),
            keypoints=bank.keypoints[i].astype(np.float64),
            keypoint_covariance=bank.covariance[i].astype(np.float64),
        )

    @property
    def intrinsics(self) -> np.ndarray:
        """Camera matrix of the reference view, (3, 3)."""
        return self.bank.K[self.scene].copy()

    @property
    def T_cam_world(self) -> np.ndarray:
        """The reference camera, (4, 4)."""
        return self.bank.T_cam_world[self.scene].copy()

    @property
    def sphere_center(self) -> np.ndarray:
        """Center of the view sphere, (3,), world."""
        return self.bank.center[self.scene].copy()

    @property
    def reference_position(self) -> SpherePosition:
        """The reference camera in spherical coordinates about the view sphere's center."""
        return SpherePosition.of(self.T_cam_world, self.sphere_center)

    def camera_pose(self, action: Any) -> np.ndarray:
        """The recorded camera that an action would lead to: T_cam_world (4, 4).

        Raises:
            InputError: if the action is not in the action space.
        """
        return self.bank.second_T_cam_world[self.scene, self._slot(action)].copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Samples a scene of the bank.

        Args:
            seed: of the environment's random number generator; None keeps its state.
            options: ``scene``, the index of a scene in the bank.

        Raises:
            InputError: if there is no such scene or option.
        """
        super().reset(seed=seed)
        drawn = self._scenes[int(self.np_random.integers(len(self._scenes)))]
        if not self._shuffle:
            drawn, self._next = self._scenes[self._next], (self._next + 1) % len(self._scenes)
        self._scene = _requested_scene(options, self._scenes, drawn)
        self._mirrored = self._mirror is not None and bool(self.np_random.integers(2))
        self._ended = False
        observation = {key: array[self._scene].copy() for key, array in self.bank.first.items()}
        return self._mirror_if_drawn(observation), self._info(None)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Takes a recorded second view; the episode ends.

        Raises:
            InputError: if the action is NaN or not in the action space.
            ResetNeeded: if the episode has ended.
        """
        scene, bank = self.scene, self.bank
        if self._ended:
            raise ResetNeeded("the episode has ended: call reset() first")
        slot = self._slot(action)
        self._ended = True
        fixed = {key: bank.first[key][scene].copy() for key in ("object", "image")}
        observation = fixed | {k: array[scene, slot].copy() for k, array in bank.second.items()}
        observation = {key: observation[key] for key in bank.first}
        error, travel = float(bank.second_error[scene, slot]), float(bank.travel[scene, slot])
        reward = -min(error, 1.0) - self.travel_weight * travel
        return self._mirror_if_drawn(observation), reward, True, False, self._info(slot)

    def simulate_actions(
        self, actions: Sequence[Any]
    ) -> list[tuple[Observation, float, bool, bool, dict[str, Any]]]:
        """Returns what ``step`` would return for each action, without taking it."""
        outputs = []
        for action in actions:
            outputs.append(self.step(action))
            self._ended = False
        return outputs

    def _mirror_if_drawn(self, observation: Observation) -> Observation:
        if self._mirror is None or not self._mirrored:
            return observation
        return self._mirror.observation(observation)

    def _slot(self, action: Any) -> int:
        """The index of the recorded view that an action chooses."""
        if isinstance(self.action_space, spaces.Discrete):
            slot = candidate_view(action, self.bank.slots)
            return int(self._mirror.slots[slot]) if self._mirror and self._mirrored else slot
        azimuth, elevation, distance = box_view(action)
        if self._mirrored:
            azimuth = -azimuth
        wanted = view_sphere_pose(
            self.sphere_center, distance, self.reference_position.azimuth + azimuth, elevation
        )
        offset = camera_center(wanted) - self.sphere_center
        recorded = self.bank.second_T_cam_world[self.scene]
        offsets = camera_center(recorded) - self.sphere_center
        distances = np.linalg.norm(offsets, axis=1)
        cosine = (offsets @ offset) / (distances * np.linalg.norm(offset))
        angle = np.arccos(np.clip(cosine, -1, 1))
        return int(np.argmin(angle + _RADIANS_PER_METER * np.abs(distances - distance)))

    def _info(self, slot: int | None) -> dict[str, Any]:
        bank, scene = self.bank, self.scene
        index = int(bank.object_index[scene])
        diameter = bank.header.diameters[index]
        errors = [float(bank.first_error[scene]) * diameter]
        T_cam_world, T_cam_obj, travel = bank.T_cam_world[scene], bank.T_cam_obj[scene], 0.0
        if slot is not None:
            errors.append(float(bank.second_error[scene, slot]) * diameter)
            T_cam_world = bank.second_T_cam_world[scene, slot]
            T_cam_obj = bank.second_T_cam_obj[scene, slot]
            travel = float(bank.travel[scene, slot])
        return {
            "object": self.object_names[index],
            "diameter": diameter,
            "scene_seed": int(bank.scene_seed[scene]),
            "T_cam_world": T_cam_world.copy(),
            "T_cam_obj": T_cam_obj.copy(),
            "travel": travel,
            "baseline_deg": angle_at(self.sphere_center, bank.T_cam_world[scene], T_cam_world),
            "ground_truth": ground_truth(float(bank.visibility[scene]), errors, diameter),
        }


@lru_cache(maxsize=4)
def load_bank_cached(path: str) -> ViewBank:
    """Reads a bank once per process."""
    return read_bank(path)


def _requested_scene(options: Mapping[str, Any] | None, scenes: range, drawn: int) -> int:
    """The scene in the options of ``reset``, else ``drawn``."""
    unknown = sorted(set(options or {}) - {"scene"})
    if unknown:
        raise InputError(f"unknown reset option(s) {unknown}; allowed is scene")
    if not options:
        return drawn
    scene = options["scene"]
    if scene not in scenes:
        raise InputError(
            f"scene must be a number from {scenes.start} to {scenes.stop - 1}, got {scene!r}"
        )
    return int(scene)
