"""What would come of an action, without taking it: for recording, and for the oracle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from ..pose_estimator.batching import batch_size, estimate_all
from .base import ViewSelectionEnv
from .episode import Episode
from .observation import Observation


class PeekingEnv(ViewSelectionEnv):
    """An environment that can be asked what a step would return."""

    def peek(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """What ``step(action)`` would return now; the episode stays as it is.

        Raises:
            ValueError: as :meth:`step`.
            ResetNeeded: as :meth:`step`.
        """
        return self.peek_all([action])[0]

    def peek_all(
        self, actions: Sequence[Any]
    ) -> list[tuple[Observation, float, bool, bool, dict[str, Any]]]:
        """What :meth:`peek` returns for each action; the estimator is asked for several at once.

        For recording many second views of one scene, and for the policy that knows the answer.

        Raises:
            ValueError: as :meth:`step`.
            ResetNeeded: as :meth:`step`.
        """
        with self._as_it_is() as before:
            answers = []
            size = batch_size(self._estimator)
            for start in range(0, len(actions), size):
                ways = [before.copy() for _ in actions[start : start + size]]
                for way, action in zip(ways, actions[start:], strict=False):
                    self._episode = way
                    self._carrier.place(before.cameras[-1])
                    T_cam_world = self.move(action)
                    self.see(T_cam_world, self._studio.shoot(T_cam_world, len(way.views)))
                if self._estimator is not None:
                    requests = [(tuple(way.views), way.object_name) for way in ways]
                    for way, estimate in zip(
                        ways, estimate_all(self._estimator, requests), strict=True
                    ):
                        self._episode = way
                        self.learn(estimate)
                for way in ways:
                    self._episode = way
                    answers.append(self.outcome())
            return answers

    @contextmanager
    def _as_it_is(self) -> Iterator[Episode]:
        """Afterwards the episode is what it was before, whatever was done to it."""
        before, mode = self._running(), self.render_mode
        self.render_mode = None
        try:
            yield before
        finally:
            self._episode, self.render_mode = before, mode
            self._carrier.place(before.cameras[-1])
