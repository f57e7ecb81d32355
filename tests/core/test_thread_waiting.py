"""Threads are told to sleep where that can still act, and never against the user's word."""

import os
import subprocess
import sys

import pytest
from two_view_pose.core import thread_waiting as waiting

ASK = """
import os
from two_view_pose.core import thread_waiting as waiting
print({name: os.environ[name] for name in waiting.VARIABLES if name in os.environ})
print(waiting.how_threads_wait())
"""


def fresh(code: str, **said: str) -> str:
    """What a fresh interpreter prints, in an environment that says only this of waiting."""
    kept = {name: value for name, value in os.environ.items() if name not in waiting.VARIABLES}
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=kept | said
    )
    return run.stdout


def test_the_package_lets_threads_sleep():
    said, words = fresh(f"import two_view_pose{ASK}").splitlines()
    assert said == str(waiting.BRIEF)
    assert words.startswith("sleep when they wait long")


@pytest.mark.parametrize("name", waiting.VARIABLES)
def test_what_the_user_set_stays_alone(name):
    said, words = fresh(f"import two_view_pose{ASK}", **{name: "7"}).splitlines()
    assert said == str({name: "7"})
    assert words == f"wait as {name}=7 says"


def test_where_torch_came_first_that_is_told_and_other_processes_are_still_reached():
    said, words = fresh(f"import torch, two_view_pose{ASK}").splitlines()
    assert said == str(waiting.BRIEF)
    assert words.startswith("spin while they wait: torch was imported before")


def test_openmp_hears_it():
    """GCC's OpenMP, which PyTorch's builds for Linux bring, prints how it waits when it starts."""
    torch_sums = "import two_view_pose, torch; torch.ones(10**6).sum()"
    run = subprocess.run(
        [sys.executable, "-c", torch_sums],
        capture_output=True,
        text=True,
        check=True,
        env={n: v for n, v in os.environ.items() if n not in waiting.VARIABLES}
        | {"OMP_DISPLAY_ENV": "verbose"},
    )
    if "GOMP_SPINCOUNT" not in run.stderr:
        pytest.skip("this PyTorch's OpenMP prints nothing")
    assert "GOMP_SPINCOUNT = '10000'" in run.stderr
