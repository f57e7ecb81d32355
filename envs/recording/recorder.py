"""Records one scene of a view bank: the reference view, then every candidate view."""

import numpy as np

from ...pose_estimator.bop.objects import load_objects
from ..episode import episode_seed
from ..observation import Observation
from ..simulation.carrier import camera_center
from ..two_view_pose import CANDIDATE_VIEWS, TwoViewPoseDiscreteEnv
from ..view_banks.bank import BankHeader, scene_arrays, write_arrays
from .config import RecordBankConfig

_SecondView = tuple[Observation, np.ndarray, np.ndarray, float]
"""Observation, camera (4, 4), estimate (4, 4) and travel (m) of a second view."""


class BankRecorder:
    """Takes every action of every scene in a live environment."""

    def __init__(self, config: RecordBankConfig) -> None:
        self._config = config
        self._env = TwoViewPoseDiscreteEnv(**config.environment_arguments)

    def make(self, scene_id: int) -> None:
        """Records one scene and writes its file."""
        env = self._env
        first, info = env.reset(seed=episode_seed(self._config.seed, scene_id))
        assert env.estimate is not None
        if self._config.estimates:
            seconds, errors = self._estimate_all_views()
        else:
            seconds = self._unestimated_views(first)
            errors = [np.nan] * len(seconds)
        arrays = scene_arrays(first, env.estimate, seconds)
        diameter, truth = info["diameter"], info["ground_truth"]
        cameras = arrays["second_T_cam_world"][0]
        arrays |= {
            "object_index": np.array([env.object_names.index(info["object"])], np.int16),
            "scene_seed": np.array([info["scene_seed"]], np.int64),
            "visibility": np.array([truth["visibility"]], np.float32),
            "K": env.intrinsics[None],
            "T_cam_world": env.T_cam_world[None],
            "centre": env.sphere_center[None],
            "first_error": np.array([truth["add_first"] / diameter], np.float32),
            "second_error": np.array([errors], np.float32),
            "second_visibility": np.array([[env.visibility_from(T) for T in cameras]], np.float32),
        }
        write_arrays(self._config.part_path(scene_id), arrays)

    def close(self) -> None:
        """Closes the environment."""
        self._env.close()

    def _estimate_all_views(self) -> tuple[list[_SecondView], list[float]]:
        """The second views as ``scene_arrays`` takes them, and ADD(-S) over the diameter."""
        outputs = self._env.simulate_actions(range(len(CANDIDATE_VIEWS)))
        infos = [info for *_, info in outputs]
        seconds = [
            (observation, info["T_cam_world"], info["T_cam_obj"], info["travel"])
            for observation, *_, info in outputs
        ]
        return seconds, [i["ground_truth"]["add_second"] / i["diameter"] for i in infos]

    def _unestimated_views(self, first: Observation) -> list[_SecondView]:
        """The second views with the first observation and estimate for each."""
        env = self._env
        assert env.estimate is not None
        cameras = [env.camera_pose(action) for action in range(len(CANDIDATE_VIEWS))]
        start = camera_center(env.T_cam_world)
        return [
            (first, T, env.estimate.T_cam_obj, float(np.linalg.norm(camera_center(T) - start)))
            for T in cameras
        ]


def make_header(config: RecordBankConfig) -> BankHeader:
    """Metadata of a bank of simulated scenes."""
    objects = load_objects(list(config.objects) or None, config.unit)
    return BankHeader(
        source="simulation",
        scene=config.scene,
        object_names=tuple(objects),
        diameters=tuple(float(model.diameter) for model in objects.values()),
        candidate_views=CANDIDATE_VIEWS,
        estimator=config.estimator,
        seed=config.seed,
        settings={} if config.pose_noise is None else {"pose_noise": config.pose_noise},
    )
