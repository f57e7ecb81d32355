"""Counterfactual steps: what a step would return, for recording and for the oracle."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from ..pose_estimator.fusion.batching import batch_size, estimate_all
from .base import ViewSelectionEnv
from .episode import Episode
from .observation import Observation


class CounterfactualEnv(ViewSelectionEnv):
    """An environment that can return the outcome of a step without taking it."""

    def simulate_actions(
        self, actions: Sequence[Any]
    ) -> list[tuple[Observation, float, bool, bool, dict[str, Any]]]:
        """What ``step`` would return (or raise) for each action, with estimates in batches."""
        with self._restored_episode() as before:
            outputs = []
            size = batch_size(self._estimator)
            for start in range(0, len(actions), size):
                episodes = [before.copy() for _ in actions[start : start + size]]
                for episode, action in zip(episodes, actions[start:], strict=False):
                    self._episode = episode
                    self._carrier.place(before.cameras[-1])
                    T_cam_world = self.move(action)
                    image = self._simulator.render(T_cam_world, len(episode.views))
                    self.add_view(T_cam_world, image)
                requests = [(tuple(episode.views), episode.object_name) for episode in episodes]
                if self._estimator is not None:
                    estimates = estimate_all(self._estimator, requests)
                    for episode, estimate in zip(episodes, estimates, strict=True):
                        episode.add_estimate(estimate)
                for episode in episodes:
                    self._episode = episode
                    outputs.append(self.step_output())
            return outputs

    @contextmanager
    def _restored_episode(self) -> Iterator[Episode]:
        """Yields the episode, and restores it at the end of the block."""
        before, mode = self._running(), self.render_mode
        self.render_mode = None
        try:
            yield before
        finally:
            self._episode, self.render_mode = before, mode
            self._carrier.place(before.cameras[-1])
