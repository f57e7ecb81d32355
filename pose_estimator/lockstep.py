"""Several estimates side by side, whose questions to the networks are answered together.

Each estimate runs in a thread of its own, one thread at a time, until it asks the networks
something. When all of them wait, their questions are answered as one batch. An estimate need not
know of this: it calls ``ask`` as it would alone, and gets the same answers.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

from .inference import Ask, Question

T = TypeVar("T")


def in_lockstep(
    tasks: Sequence[Callable[[Ask], T]], answer: Callable[[Sequence[Question]], list[Any]]
) -> list[T]:
    """Runs tasks side by side.

    Args:
        tasks: each is given what it is to ask its questions with.
        answer: answers the questions of all tasks that have not ended.

    Returns:
        What each task returned.

    Raises:
        Exception: of the first task that failed, or of ``answer``; the others are ended.
    """
    lanes = [_Lane(task) for task in tasks]
    try:
        for lane in lanes:
            lane.go_on()
        while asking := [lane for lane in lanes if not lane.ended]:
            answers = answer([lane.question for lane in asking])
            for lane, found in zip(asking, answers, strict=True):
                lane.go_on(found)
    finally:
        for lane in lanes:
            lane.give_up()
    return [lane.result() for lane in lanes]


class _GivenUp(BaseException):
    """Ends a task whose question will not be answered; not an error that it should catch."""


class _Lane(Generic[T]):
    """One task in its thread; it and the caller never run at the same time."""

    def __init__(self, task: Callable[[Ask], T]) -> None:
        self.question: Question = None
        self.ended = False
        self._answer: Any = None
        self._given_up = False
        self._error: BaseException | None = None
        self._value: list[T] = []
        self._mine, self._callers = threading.Semaphore(0), threading.Semaphore(0)
        self._thread = threading.Thread(target=self._run, args=(task,), daemon=True)
        self._thread.start()

    def go_on(self, answer: Any = None) -> None:
        """Lets the task run with an answer until it asks again or ends.

        Raises:
            Exception: the task's, if it failed.
        """
        self._answer = answer
        self._mine.release()
        self._callers.acquire()
        if self._error is not None and not self._given_up:
            raise self._error

    def give_up(self) -> None:
        """Ends a task that still waits."""
        if not self.ended:
            self._given_up = True
            self.go_on()
        self._thread.join()

    def result(self) -> T:
        """What the task returned."""
        return self._value[0]

    def _run(self, task: Callable[[Ask], T]) -> None:
        self._mine.acquire()
        try:
            if not self._given_up:
                self._value = [task(self._ask)]
        except BaseException as error:
            self._error = error
        self.ended = True
        self._callers.release()

    def _ask(self, question: Question) -> Any:
        self.question = question
        self._callers.release()
        self._mine.acquire()
        if self._given_up:
            raise _GivenUp
        answer, self._answer, self.question = self._answer, None, None
        return answer
