import threading

import pytest
from two_view_pose.pose_estimator.lockstep import in_lockstep


def counting(questions):
    """An answerer that keeps what it was asked together."""
    asked = []

    def answer(now):
        asked.append(list(now))
        return [questions[question] for question in now]

    return answer, asked


def test_questions_of_all_tasks_are_answered_together():
    answer, asked = counting({"a": 1, "b": 2, "c": 3, "d": 4})

    def task(*names):
        return lambda ask: sum(ask(name) for name in names)

    assert in_lockstep([task("a", "b"), task("c"), task(), task("d", "a", "b")], answer) == [
        3, 3, 0, 7,
    ]  # fmt: skip
    assert asked == [["a", "c", "d"], ["b", "a"], ["b"]]


def test_only_one_task_runs_at_a_time():
    running, most = [], []

    def task(ask):
        for _ in range(3):
            running.append(None)
            most.append(len(running))
            running.pop()
            ask(None)

    in_lockstep([task] * 4, lambda now: [None] * len(now))
    assert max(most) == 1


def test_a_task_that_fails_ends_the_others():
    ended = []

    def waits(ask):
        try:
            ask("x")
            ask("y")
        finally:
            ended.append(True)

    def fails(ask):
        ask("x")
        raise ValueError("no such object")

    threads = threading.active_count()
    with pytest.raises(ValueError, match="no such object"):
        in_lockstep([waits, fails, waits], lambda now: now)
    assert ended == [True, True] and threading.active_count() == threads


def test_an_answer_that_fails_ends_all():
    def broken(now):
        raise MemoryError("too much")

    threads = threading.active_count()
    with pytest.raises(MemoryError, match="too much"):
        in_lockstep([lambda ask: ask(1)] * 3, broken)
    assert threading.active_count() == threads


def test_nothing_to_do():
    assert in_lockstep([], lambda now: now) == []
