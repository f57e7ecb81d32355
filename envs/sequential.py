"""Several second views: take more until the pose is good enough or the budget is spent."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from gymnasium import spaces

from ..core.errors import InputError
from ..core.validation import require_within
from .actions import candidate_view
from .episode import Episode
from .observation import Observation
from .simulation.simulator import MAX_VIEWS
from .two_view_pose import TwoViewPoseDiscreteEnv


class TwoViewPoseSequentialEnv(TwoViewPoseDiscreteEnv):
    """`TwoViewPoseDiscrete-v0` with a budget of several second views, and an action to stop.

    ## Description

    After every view the estimator estimates the pose from all views so far, and the agent decides:
    take another view, and from where, or stop. Each view and each meter of travel has a cost; the
    accuracy of the last pose is rewarded at the end.

    ## Action Space

    `Discrete(25)`: the 24 candidates of `TwoViewPoseDiscrete-v0`, always around the object as
    estimated from the reference view and relative to the reference camera's azimuth; 24 stops.

    ## Observation Space

    That of `TwoViewPose-v0`, for the latest estimate and camera, and

    | Key          | Shape | Content                                              |
    |--------------|-------|------------------------------------------------------|
    | `views_left` | (1,)  | fraction of the budget that is left, 0 to 1          |
    | `taken`      | (24,) | 1 where a candidate has been taken in this episode   |

    ## Rewards

    `-view_weight - travel_weight * travel` for each view, where `travel` is the distance from the
    previous camera; and at the end of the episode `-min(ADD(-S) / diameter, 1)`.

    ## Episode End

    `terminated` by the stop action, or with the last view of the budget.

    ## Info

    As in `TwoViewPose-v0`; `ground_truth["add_second"]` is the error of the latest estimate (before
    any second view, of the first one); `second_views` is the number of second views.

    ## Arguments

    Those of `TwoViewPoseDiscreteEnv`, and

    | Argument      | Default | Meaning                                |
    |---------------|---------|----------------------------------------|
    | `budget`      | 3       | maximum number of second views, 1 to 7 |
    | `view_weight` | 0.02    | cost of a second view                  |

    ## Version History

    * v0: first release
    """

    def __init__(self, *, budget: int = 3, view_weight: float = 0.02, **kwargs: Any) -> None:
        if not 1 <= budget < MAX_VIEWS:
            raise InputError(f"budget must be 1 to {MAX_VIEWS - 1} second views, got {budget}")
        self._budget, self.view_weight = budget, float(view_weight)
        require_within(self, 0, np.inf, "view_weight")
        self._taken: list[int] = []
        super().__init__(**kwargs)
        left = spaces.Box(0.0, 1.0, (1,), np.float32)
        taken = spaces.Box(0.0, 1.0, (len(self._candidates),), np.float32)
        added = {"views_left": left, "taken": taken}
        self.observation_space = spaces.Dict({**self._fields.spaces, **added})

    @property
    def stop_action(self) -> int:
        """The action that ends the episode with the latest estimate."""
        return len(self._candidates)

    @property
    def T_newest_world(self) -> np.ndarray:
        """The latest camera, (4, 4)."""
        return self._running().cameras[-1].copy()

    def make_action_space(self) -> spaces.Space[Any]:
        """The index of a candidate view, or the stop action."""
        return spaces.Discrete(len(self._candidates) + 1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """As in `TwoViewPose-v0`."""
        self._taken = []
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Takes another view, or stops; the errors are those of `TwoViewPose-v0`."""
        episode = self._unfinished()
        chosen = candidate_view(action, len(self._candidates) + 1)
        reward = 0.0
        if chosen == self.stop_action:
            episode.ended = True
        else:
            motion = self._carrier.move(self.camera_pose(chosen))
            episode.travel += motion.travel
            self._taken = [*self._taken, chosen]
            self._add_rendered_view(motion.T_cam_world)
            reward -= self.view_weight + self.travel_weight * motion.travel
            episode.ended = len(self._taken) == self._budget
        if episode.ended:
            reward -= episode.error_ratio
        if self.render_mode == "human":
            self.render()
        return self._observation(), float(reward), episode.ended, False, self._info()

    def simulate_actions(
        self, actions: Sequence[Any]
    ) -> list[tuple[Observation, float, bool, bool, dict[str, Any]]]:
        """Returns what ``step`` would return for each action, without taking it."""
        outputs = []
        for action in actions:
            with self._restored_episode() as before:
                self._episode = before.copy()
                outputs.append(self.step(action))
        return outputs

    @contextmanager
    def _restored_episode(self) -> Iterator[Episode]:
        taken = self._taken
        try:
            with super()._restored_episode() as before:
                yield before
        finally:
            self._taken = taken

    def _observation(self) -> Observation:
        taken = np.zeros(len(self._candidates), np.float32)
        taken[self._taken] = 1.0
        left = np.array([1.0 - len(self._taken) / self._budget], np.float32)
        return super()._observation() | {"views_left": left, "taken": taken}

    def _info(self) -> dict[str, Any]:
        info = super()._info()
        episode = self._running()
        if episode.errors:
            info["ground_truth"]["add_second"] = episode.errors[-1]
        return info | {"second_views": len(self._taken)}
