"""Several environments at once: one batched estimate for all, rendering beside it.

``gym.make_vec`` finds these through ``vector_entry_point``. They reset in the same step, which
episodes of one step want: an environment that resets in the next would waste half of all steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate

from ..pose_estimator.batching import estimate_all
from ..pose_estimator.cores import available_cores
from ..pose_estimator.estimate import PoseEstimate
from ..pose_estimator.thread_pools import single_core_threads
from .base import ViewSelectionEnv
from .protocol import PoseEstimator, resolve_estimator
from .studio import LocalStudio, SceneOrder, StudioConfig
from .studio_workers import RemoteStudio, StudioWorkers
from .two_view_pose import TwoViewPoseDiscreteEnv, TwoViewPoseEnv

_Estimates = Future[list[PoseEstimate]] | None
"""Of some lanes; None without an estimator."""


def make_two_view_pose(num_envs: int = 1, **kwargs: Any) -> TwoViewPoseVectorEnv:
    """Several ``TwoViewPose-v0``; see :class:`TwoViewPoseVectorEnv`."""
    return TwoViewPoseVectorEnv(TwoViewPoseEnv, num_envs, **kwargs)


def make_two_view_pose_discrete(num_envs: int = 1, **kwargs: Any) -> TwoViewPoseVectorEnv:
    """Several ``TwoViewPoseDiscrete-v0``; see :class:`TwoViewPoseVectorEnv`."""
    return TwoViewPoseVectorEnv(TwoViewPoseDiscreteEnv, num_envs, **kwargs)


class TwoViewPoseVectorEnv(VectorEnv[Any, Any, Any]):
    """Lanes of one environment, each with a scene of its own.

    Lane ``i`` answers exactly as a single environment does that was reset with its seed (with an
    estimator on a GPU: but for the rounding of another batch). A step
    takes the second view of every lane, asks the estimator once for all lanes
    (``estimate_batch``, where it has one), and begins every lane's next episode; what the last step
    of an episode showed is in ``info["final_obs"]`` and ``info["final_info"]``. While the estimator
    works on one half of a step, the workers arrange and render the other.

    Args:
        kind: the environment of a lane, whose episodes are one step.
        num_envs: how many lanes.
        workers: processes that arrange and render scenes; None: as many as there are cores, and no
            more than lanes; 0: this process does it.
        **kwargs: go to the environment of each lane.

    Raises:
        ValueError: if a number or an argument is not allowed.
    """

    def __init__(
        self,
        kind: type[ViewSelectionEnv],
        num_envs: int = 1,
        *,
        workers: int | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__()
        if kind.step is not ViewSelectionEnv.step:
            raise ValueError(f"{kind.__name__} has steps of its own: use gymnasium's SyncVectorEnv")
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, got {num_envs}")
        if workers is not None and workers < 0:
            raise ValueError(f"workers must be at least 0, or None, got {workers}")
        count = min(num_envs, available_cores()) if workers is None else workers
        self.num_envs = num_envs
        self._workers: StudioWorkers | None = None
        self._studios: list[_LateStudio | RemoteStudio] = []

        def studio(config: StudioConfig) -> _LateStudio | RemoteStudio:
            if count and self._workers is None:
                self._workers = StudioWorkers(config, num_envs, count)
            lane = len(self._studios)
            made = RemoteStudio(self._workers, lane) if self._workers else _LateStudio(config)
            self._studios.append(made)
            return made

        self._estimator = resolve_estimator(
            kwargs.pop("estimator", "mid"), kwargs.pop("device", "auto")
        )
        # An estimator that bears it is asked from two threads: while one computes between the
        # networks, which Python does on one core, the networks run for the other.
        crews = min(2, num_envs) if getattr(self._estimator, "thread_safe", False) else 1
        self._crews = [list(part) for part in np.array_split(range(num_envs), crews)]
        self._pool = single_core_threads(crews) if crews > 1 else ThreadPoolExecutor(1)
        self.envs = [
            kind(estimator=self._estimator, studio=studio, **kwargs) for _ in range(num_envs)
        ]
        first = self.envs[0]
        self.metadata = {**first.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self.render_mode = first.render_mode
        self.single_observation_space, self.single_action_space = (
            first.observation_space,
            first.action_space,
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    @property
    def estimator(self) -> PoseEstimator | None:
        """The one estimator of all lanes."""
        return self._estimator

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begins an episode in every lane.

        Args:
            seed: of each lane; of a number, the lanes take it and those that follow.
            options: of every lane, as the single environment's.

        Raises:
            ValueError: if there is not one seed for each lane, or an option is not allowed.
        """
        if seed is None or isinstance(seed, int | np.integer):
            seeds = [None if seed is None else int(seed) + lane for lane in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed must be one for each of {self.num_envs} lanes, got {seeds}")
        self._forget_orders()
        orders = [
            env.draw_order(number, options) for env, number in zip(self.envs, seeds, strict=True)
        ]
        self._order_openings(orders)
        opened = [self._begin(lanes, orders) for lanes in self._crews]
        return self._open(opened, {})

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Takes every lane's second view, and begins its next episode.

        Raises:
            ValueError: if an action is not allowed; no lane has moved then.
            ResetNeeded: before the first reset.
        """
        chosen = list(iterate(self.action_space, actions))
        for env, action in zip(self.envs, chosen, strict=True):
            env.camera_pose(action)  # raises before anything moves
        cameras = [env.move(action) for env, action in zip(self.envs, chosen, strict=True)]
        for studio, T_cam_world in zip(self._studios, cameras, strict=True):
            studio.order_picture(T_cam_world, 1)
        orders = [env.draw_order(None, None) for env in self.envs]
        self._order_openings(orders)
        seen = []
        for lanes in self._crews:
            for lane in lanes:
                self.envs[lane].see(cameras[lane], self._studios[lane].collect()[1])
            seen.append(self._estimate(lanes))
        rewards = np.zeros(self.num_envs)
        infos: dict[str, Any] = {}
        opened = []
        for lanes, estimates in zip(self._crews, seen, strict=True):
            self._learn(lanes, estimates)
            for lane in lanes:
                observation, rewards[lane], *_, info = self.envs[lane].outcome()
                final = {"final_obs": observation, "final_info": info}
                infos = self._add_info(infos, final, lane)
            opened.append(self._begin(lanes, orders))
        observations, infos = self._open(opened, infos)
        ended = np.ones(self.num_envs, np.bool_)
        return observations, rewards, ended, ~ended, infos

    def render(self) -> tuple[Any, ...]:
        """The picture of each lane's episode, as the single environment draws it."""
        return tuple(env.render() for env in self.envs)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Calls a method of each lane, or gets an attribute."""
        found = [getattr(env, name) for env in self.envs]
        return tuple(f(*args, **kwargs) if callable(f) else f for f in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of each lane."""
        return tuple(getattr(env, name) for env in self.envs)

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the workers and frees the lanes."""
        self._pool.shutdown()
        for env in self.envs:
            env.close()
        if self._workers is not None:
            self._workers.close()

    def _order_openings(self, orders: Sequence[SceneOrder]) -> None:
        for studio, order in zip(self._studios, orders, strict=True):
            studio.order_opening(order)

    def _forget_orders(self) -> None:
        """Takes back what was ordered and not collected, as after an error in a step."""
        if self._workers is not None:
            self._workers.drain()
        for studio in self._studios:
            studio.forget()

    def _begin(self, lanes: Sequence[int], orders: Sequence[SceneOrder]) -> _Estimates:
        """Begins the episodes that were ordered, up to the first estimate."""
        for lane in lanes:
            setup, picture = self._studios[lane].collect()
            self.envs[lane].begin(orders[lane], setup)
            self.envs[lane].see(setup.T_cam_world, picture)
        return self._estimate(lanes)

    def _open(
        self, opened: Sequence[_Estimates], infos: dict[str, Any]
    ) -> tuple[Any, dict[str, Any]]:
        """What the episodes that were begun show: observations, and the infos with theirs."""
        observations = []
        for lanes, estimates in zip(self._crews, opened, strict=True):
            self._learn(lanes, estimates)
            for lane in lanes:
                observation, info = self.envs[lane].opening()
                observations.append(observation)
                infos = self._add_info(infos, info, lane)
        empty = create_empty_array(self.single_observation_space, n=self.num_envs)
        assert empty is not None
        return concatenate(self.single_observation_space, observations, empty), infos

    def _estimate(self, lanes: Sequence[int]) -> _Estimates:
        """Begins to estimate the poses of some lanes from their views so far."""
        requests = [(self.envs[lane].views, self.envs[lane].object_name) for lane in lanes]
        if self._estimator is None:
            return None
        return self._pool.submit(estimate_all, self._estimator, requests)

    def _learn(self, lanes: Sequence[int], estimates: _Estimates) -> None:
        """Waits for the poses of some lanes."""
        if estimates is not None:
            for lane, estimate in zip(lanes, estimates.result(), strict=True):
                self.envs[lane].learn(estimate)


class _LateStudio(LocalStudio):
    """A studio in this process that takes orders as one among the workers does."""

    def __init__(self, config: StudioConfig) -> None:
        super().__init__(config)
        self._orders: list[SceneOrder | tuple[np.ndarray, int]] = []

    def order_opening(self, order: SceneOrder) -> None:
        """Orders a scene and the reference picture of it."""
        self._orders.append(order)

    def order_picture(self, T_cam_world: np.ndarray, number: int) -> None:
        """Orders a picture."""
        self._orders.append((T_cam_world, number))

    def forget(self) -> None:
        """Takes back what was ordered."""
        self._orders = []

    def collect(self) -> tuple[Any, np.ndarray]:
        """What was ordered first: the setup, if it was a scene, and the picture."""
        order = self._orders.pop(0)
        if not isinstance(order, SceneOrder):
            return None, self.shoot(*order)
        setup = self.arrange(order)
        return setup, self.shoot(setup.T_cam_world, 0)
