"""Records one scene of a view bank: the reference view, then every candidate from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..pose_estimator.estimate import PoseEstimate
from .carrier import camera_centre
from .episode import episode_seed
from .observation import Observation
from .record_bank import part_path, write_part
from .two_view_pose import CANDIDATE_VIEWS, TwoViewPoseDiscreteEnv
from .view_bank import FIRST_FIELDS, SECOND_FIELDS

if TYPE_CHECKING:
    from .record_bank import RecordBankConfig


class BankRecorder:
    """Plays every action of every scene in a live environment.

    Args:
        config: what the bank is.
    """

    def __init__(self, config: RecordBankConfig) -> None:
        self._config = config
        self._env = TwoViewPoseDiscreteEnv(**config.environment_arguments)

    def make(self, scene_id: int) -> None:
        """Records scene ``scene_id`` and writes its file."""
        env = self._env
        observation, info = env.reset(seed=episode_seed(self._config.seed, scene_id))
        estimate = env.estimate
        assert estimate is not None
        outcomes = self._outcomes(observation)
        arrays = one_scene(observation, estimate, [outcome[:4] for outcome in outcomes])
        diameter, truth = info["diameter"], info["ground_truth"]
        cameras = arrays["second_T_cam_world"][0]
        arrays |= {
            "object_index": np.array([env.object_names.index(info["object"])], np.int16),
            "scene_seed": np.array([info["scene_seed"]], np.int64),
            "visibility": np.array([truth["visibility"]], np.float32),
            "K": env.intrinsics[None],
            "T_cam_world": env.T_cam_world[None],
            "centre": env.sphere_centre[None],
            "first_error": np.array([truth["add_first"] / diameter], np.float32),
            "second_error": np.array([[outcome[4] for outcome in outcomes]], np.float32),
            "second_visibility": np.array([[env.visibility_from(T) for T in cameras]], np.float32),
        }
        write_part(part_path(self._config, scene_id), arrays)

    def _outcomes(
        self, first: Observation
    ) -> list[tuple[Observation, np.ndarray, np.ndarray, float, float]]:
        """Of each second view: observation, camera, estimate, travel, ADD(-S) over the diameter."""
        env, actions = self._env, range(len(CANDIDATE_VIEWS))
        if self._config.answers:
            return [
                (
                    observation,
                    info["T_cam_world"],
                    info["T_cam_obj"],
                    info["travel"],
                    info["ground_truth"]["add_second"] / info["diameter"],
                )
                for observation, _, _, _, info in env.peek_all(actions)
            ]
        assert env.estimate is not None
        T_cam_obj, outcomes = env.estimate.T_cam_obj, []
        for action in actions:
            T_cam_world = env.camera_pose(action)
            travel = camera_centre(T_cam_world) - camera_centre(env.T_cam_world)
            distance = float(np.linalg.norm(travel))
            outcomes.append((first, T_cam_world, T_cam_obj, distance, float("nan")))
        return outcomes


def one_scene(
    first: Observation,
    estimate: PoseEstimate,
    seconds: list[tuple[Observation, np.ndarray, np.ndarray, float]],
) -> dict[str, np.ndarray]:
    """The arrays of one scene that follow from what the robot knows.

    Args:
        first: observation after the reference view.
        estimate: from the reference view.
        seconds: for each slot the observation, camera (4, 4), estimate (4, 4) and travel (m).

    Returns:
        Arrays as in :class:`~.view_bank.ViewBank`, for one scene.
    """
    arrays: dict[str, Any] = {f"first/{key}": first[key][None] for key in FIRST_FIELDS}
    for key in SECOND_FIELDS:
        arrays[f"second/{key}"] = np.stack([o[key] for o, *_ in seconds])[None]
    return arrays | {
        "T_cam_obj": estimate.T_cam_obj[None],
        "keypoints": estimate.keypoints[None].astype(np.float32),
        "covariance": estimate.keypoint_covariance[None].astype(np.float32),
        "second_T_cam_world": np.stack([T for _, T, _, _ in seconds])[None],
        "second_T_cam_obj": np.stack([T for _, _, T, _ in seconds])[None],
        "travel": np.array([[travel for *_, travel in seconds]], np.float32),
    }
