"""How PyTorch's threads wait for each other: briefly awake, then asleep.

On a processor the threads of an operation meet at its end. OpenMP lets those that are early spin
for milliseconds, which takes the cores from whoever has work left: beside busy processes an
operation then takes ten to forty times as long. Asleep at once they would wake late, and cost an
estimate on an idle machine a fifth. A tenth of a millisecond costs neither.

OpenMP reads its variables once, when torch is loaded: import ``two_view_pose`` before torch, or set
one of ``VARIABLES`` yourself. Processes that are started later inherit them in any case.
"""

from __future__ import annotations

import os
import sys

VARIABLES = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "KMP_BLOCKTIME")
"""Each says how threads wait: that of the standard, GCC's and LLVM's."""

BRIEF = {"GOMP_SPINCOUNT": "10000", "KMP_BLOCKTIME": "1"}
"""What is set where the user has set none of them: rounds of GCC's loop, milliseconds of LLVM's."""

_torch_came_first = False


def let_threads_sleep() -> None:
    """Lets OpenMP's threads sleep when they wait long, unless the user has said how they are to.

    Where torch is loaded already this reaches only processes that are started later.
    """
    global _torch_came_first
    if any(name in os.environ for name in VARIABLES):
        return
    _torch_came_first = "torch" in sys.modules
    os.environ.update(BRIEF)


def how_threads_wait() -> str:
    """What holds in this process, in words; known once :func:`let_threads_sleep` was called."""
    said = " ".join(f"{name}={os.environ[name]}" for name in VARIABLES if name in os.environ)
    if _torch_came_first:
        return f"spin while they wait: torch was imported before two_view_pose set {said}"
    ours = " ".join(f"{name}={value}" for name, value in BRIEF.items())
    return f"sleep when they wait long ({said})" if said == ours else f"wait as {said} says"
