"""The vector environment: batched estimates, and rendering in worker processes.

``gym.make_vec`` finds it through ``vector_entry_point``. It resets in the same step, since resets
in the next step would waste half of all steps of one-step episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, NoReturn

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate

from ...core.cpu_cores import available_cores
from ...core.errors import InputError
from ...core.thread_pools import single_core_threads
from ...pose_estimator.fusion.batching import estimate_all
from ...pose_estimator.methods import DEFAULT_METHOD
from ...pose_estimator.types import PoseEstimate
from ..base import ViewSelectionEnv
from ..protocol import resolve_estimator
from ..simulation.simulator import SceneInfo, SceneRequest, SceneSimulator
from ..two_view_pose import TwoViewPoseDiscreteEnv, TwoViewPoseEnv
from .remote_simulator import SimulatorWorkers

_Estimates = Future[list[PoseEstimate]] | None
"""Of a batch of sub-environments; None without an estimator."""


class TwoViewPoseVectorEnv(VectorEnv[Any, Any, Any]):
    """Sub-environments of one class; see "Vector environments" in ``TwoViewPoseEnv``.

    A step takes the second view of every sub-environment, estimates in batches (``estimate_batch``,
    if the estimator has it), and begins every next episode. While the estimator runs on one half of
    the sub-environments, the workers render the other.

    Args:
        env_cls: the class of the sub-environments, whose episodes are one step.
        num_envs: number of sub-environments.
        workers: processes that set up and render scenes; None: one for each core, at most one for
            each sub-environment; 0: render in this process.
        **kwargs: arguments of each sub-environment.

    Raises:
        InputError: if a number or an argument is not allowed.
    """

    def __init__(
        self,
        env_cls: type[ViewSelectionEnv],
        num_envs: int = 1,
        *,
        workers: int | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__()
        if env_cls.step is not ViewSelectionEnv.step:
            raise InputError(f"{env_cls.__name__} overrides step: use gymnasium's SyncVectorEnv")
        if num_envs < 1:
            raise InputError(f"num_envs must be >= 1, got {num_envs}")
        if workers is not None and workers < 0:
            raise InputError(f"workers must be >= 0 or None, got {workers}")
        self.num_envs = num_envs
        self._estimator = resolve_estimator(
            kwargs.pop("estimator", DEFAULT_METHOD), kwargs.pop("device", "auto")
        )
        # Two threads call a thread-safe estimator: while one runs Python code between networks,
        # which uses one core, the networks run for the other.
        threads = min(2, num_envs) if getattr(self._estimator, "thread_safe", False) else 1
        self._batches = [list(part) for part in np.array_split(range(num_envs), threads)]
        self._pool = single_core_threads(threads) if threads > 1 else ThreadPoolExecutor(1)
        self._simulators: list[Any] = []
        count = min(num_envs, available_cores() if workers is None else workers)
        self._workers = SimulatorWorkers(count)

        def simulator(*arguments: Any) -> Any:
            made = self._workers.add(*arguments) if count else SceneSimulator(*arguments)
            self._simulators.append(made)
            return made

        self.envs = [
            env_cls(estimator=self._estimator, simulator=simulator, **kwargs)
            for _ in range(num_envs)
        ]
        first = self.envs[0]
        self.metadata = {**first.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self.render_mode = first.render_mode
        self.single_observation_space = first.observation_space
        self.single_action_space = first.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begins an episode in every sub-environment.

        Args:
            seed: one for each, or one number: sub-environment ``i`` has ``seed + i``.
            options: as the single environment's, for every sub-environment.

        Raises:
            InputError: if there is not one seed for each, or an option is not allowed.
        """
        if seed is None or isinstance(seed, int | np.integer):
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise InputError(f"seed must be one for each of {self.num_envs} envs, got {seeds}")
        scenes = self._request_scenes(seeds, options)
        return self._reset_output([self._begin(batch, scenes) for batch in self._batches], {})

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Takes the second view of every sub-environment, and begins its next episode.

        Raises:
            InputError: if an action is not in the action space; then no camera has moved.
            ResetNeeded: before the first reset.
        """
        chosen = list(iterate(self.action_space, actions))
        for env, action in zip(self.envs, chosen, strict=True):
            env.camera_pose(action)  # raises before anything moves
        cameras = [env.move(action) for env, action in zip(self.envs, chosen, strict=True)]
        images = [
            simulator.submit("render", T_cam_world, 1)
            for simulator, T_cam_world in zip(self._simulators, cameras, strict=True)
        ]
        scenes = self._request_scenes([None] * self.num_envs, None)
        estimates = []
        for batch in self._batches:
            for i in batch:
                self.envs[i].add_view(cameras[i], images[i]())
            estimates.append(self._estimate(batch))
        rewards = np.zeros(self.num_envs)
        infos: dict[str, Any] = {}
        begun = []
        for batch, found in zip(self._batches, estimates, strict=True):
            self._add_estimates(batch, found)
            for i in batch:
                observation, rewards[i], *_, info = self.envs[i].step_output()
                final = {"final_obs": observation, "final_info": info}
                infos = self._add_info(infos, final, i)
            begun.append(self._begin(batch, scenes))
        observations, infos = self._reset_output(begun, infos)
        terminated = np.ones(self.num_envs, np.bool_)
        return observations, rewards, terminated, ~terminated, infos

    def __deepcopy__(self, memo: dict[int, Any]) -> NoReturn:
        raise TypeError(
            "a vector environment cannot be copied, since its scenes are in other processes: make "
            "another, or copy a single environment"
        )

    def render(self) -> tuple[Any, ...]:
        """Renders each sub-environment."""
        return tuple(env.render() for env in self.envs)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Calls a method of each sub-environment, or returns an attribute."""
        found = self.get_attr(name)
        return tuple(f(*args, **kwargs) if callable(f) else f for f in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Returns an attribute of each sub-environment."""
        return tuple(getattr(env, name) for env in self.envs)

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the sub-environments and their workers."""
        self._pool.shutdown()
        for env in self.envs:
            env.close()
        self._workers.close()

    def _request_scenes(
        self, seeds: Sequence[int | None], options: dict[str, Any] | None
    ) -> list[tuple[SceneRequest, Callable[[], SceneInfo]]]:
        """Begins to set up every next scene; returns its request and a function that waits."""
        requests = [
            env.sample_scene_request(seed, options)
            for env, seed in zip(self.envs, seeds, strict=True)
        ]
        return [
            (request, simulator.submit("reset", request))
            for simulator, request in zip(self._simulators, requests, strict=True)
        ]

    def _begin(
        self, batch: Sequence[int], scenes: Sequence[tuple[SceneRequest, Callable[[], SceneInfo]]]
    ) -> _Estimates:
        """Begins the next episodes of a batch, and their first estimates."""
        for i in batch:
            request, scene = scenes[i]
            self.envs[i].begin(request, scene())
        return self._estimate(batch)

    def _reset_output(
        self, begun: Sequence[_Estimates], infos: dict[str, Any]
    ) -> tuple[Any, dict[str, Any]]:
        """Returns the observations of the new episodes, and ``infos`` with theirs added."""
        observations = []
        for batch, estimates in zip(self._batches, begun, strict=True):
            self._add_estimates(batch, estimates)
            for i in batch:
                observation, info = self.envs[i].reset_output()
                observations.append(observation)
                infos = self._add_info(infos, info, i)
        empty = create_empty_array(self.single_observation_space, n=self.num_envs)
        assert empty is not None
        return concatenate(self.single_observation_space, observations, empty), infos

    def _estimate(self, batch: Sequence[int]) -> _Estimates:
        """Begins to estimate the poses of a batch from all its views so far."""
        if self._estimator is None:
            return None
        requests = [(self.envs[i].views, self.envs[i].object_name) for i in batch]
        return self._pool.submit(estimate_all, self._estimator, requests)

    def _add_estimates(self, batch: Sequence[int], estimates: _Estimates) -> None:
        """Waits for the estimates of a batch."""
        if estimates is not None:
            for i, estimate in zip(batch, estimates.result(), strict=True):
                self.envs[i].add_estimate(estimate)


make_two_view_pose = partial(TwoViewPoseVectorEnv, TwoViewPoseEnv)
make_two_view_pose_discrete = partial(TwoViewPoseVectorEnv, TwoViewPoseDiscreteEnv)
