"""OpenMP's wait policy: set unless the user has, and inherited by child processes."""

import os
import subprocess
import sys

import pytest
from two_view_pose.core import thread_waiting as waiting

ASK = """
import os
from two_view_pose.core import thread_waiting as waiting
print({name: os.environ[name] for name in waiting.VARIABLES if name in os.environ})
print(waiting.describe_wait_policy())
"""


def fresh(code: str, **variables: str) -> str:
    """What a fresh interpreter prints, in an environment with only these wait variables."""
    kept = {name: value for name, value in os.environ.items() if name not in waiting.VARIABLES}
    run = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=kept | variables,
    )
    return run.stdout


def test_the_package_lets_threads_sleep():
    printed, words = fresh(f"import two_view_pose{ASK}").splitlines()
    assert printed == str(waiting.BRIEF)
    assert words.startswith("sleep when they wait long")


@pytest.mark.slow
@pytest.mark.parametrize("name", waiting.VARIABLES)
def test_user_settings_are_kept(name):
    printed, words = fresh(f"import two_view_pose{ASK}", **{name: "7"}).splitlines()
    assert printed == str({name: "7"})
    assert words == f"wait as {name}=7 says"


@pytest.mark.slow
def test_torch_imported_first():
    printed, words = fresh(f"import torch, two_view_pose{ASK}").splitlines()
    assert printed == str(waiting.BRIEF)
    assert words.startswith("spin while they wait: torch was imported before")


@pytest.mark.slow
def test_openmp_reads_the_variables():
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
