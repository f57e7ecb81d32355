"""OpenMP's wait policy: PyTorch's threads spin briefly at a barrier, then sleep.

By default early threads spin for milliseconds, which takes cores from threads with work left: next
to busy processes an operation takes ten to forty times as long. Without spinning they wake late, a
fifth of an estimate on an idle machine. Spinning for 0.1 ms costs neither.

OpenMP reads its variables once, when torch is loaded: import ``two_view_pose`` before torch, or set
one of ``VARIABLES`` yourself. Child processes inherit them in any case.
"""

import os
import sys

VARIABLES = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "KMP_BLOCKTIME")
"""The wait policy's variables: of the standard, GCC and LLVM."""

BRIEF = {"GOMP_SPINCOUNT": "10000", "KMP_BLOCKTIME": "1"}
"""Our values: iterations of GCC's loop, milliseconds of LLVM's."""

_torch_came_first = False


def set_wait_policy() -> None:
    """Sets OpenMP's wait policy unless the user has; acts on child processes if torch is loaded."""
    global _torch_came_first
    if any(name in os.environ for name in VARIABLES):
        return
    _torch_came_first = "torch" in sys.modules
    os.environ.update(BRIEF)


def describe_wait_policy() -> str:
    """Describes the wait policy of this process, after :func:`set_wait_policy`."""
    variables = " ".join(f"{name}={os.environ[name]}" for name in VARIABLES if name in os.environ)
    if _torch_came_first:
        return f"spin while they wait: torch was imported before two_view_pose set {variables}"
    ours = " ".join(f"{name}={value}" for name, value in BRIEF.items())
    return (
        f"sleep when they wait long ({variables})"
        if variables == ours
        else f"wait as {variables} says"
    )
