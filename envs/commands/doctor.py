"""The command ``doctor``: checks this installation, and says what to install if a check fails."""

import platform
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

from ...core.cpu_cores import available_cores
from ...core.processor import instructions, limits, number_format, processor_name
from ...core.results import versions, write_results
from ...core.thread_waiting import describe_wait_policy
from ...pose_estimator.methods import DEFAULT_METHOD

_WARM_UP = 2
"""Estimates of each method that are not timed."""

_ESTIMATES = 5
"""Timed estimates of each method; the median counts."""

_RENDER = "from two_view_pose.envs.simulation import graphics; graphics.check_rendering()"


@dataclass(frozen=True)
class DoctorConfig:
    """Checks this installation; exits with 1 if a required check fails."""

    quick: bool = False
    """Only check rendering."""
    json: Path | None = None
    """Results file with one record per check: 1 passed, 0 failed."""


@dataclass(frozen=True)
class Check:
    """The outcome of one check.

    Attributes:
        name: of the check.
        passed: None if it is only information.
        text: what was found, or what to do.
    """

    name: str
    passed: bool | None
    text: str


def check_opengl() -> Check:
    """Renders one small image in a subprocess, since a broken driver may crash it."""
    try:
        process = subprocess.run(
            [sys.executable, "-c", _RENDER], capture_output=True, text=True, timeout=120
        )
    except subprocess.TimeoutExpired:
        return Check("OpenGL", False, "no image within 120 s")
    if process.returncode == 0:
        return Check("OpenGL", True, f"{process.stdout.strip()} renders")
    lines = [line for line in process.stderr.splitlines() if line.strip()]
    if not lines:
        return Check("OpenGL", False, f"the renderer exited with code {process.returncode}")
    return Check("OpenGL", False, re.sub(r"^[\w.]+(Error|Unavailable): ", "", lines[-1].strip()))


def check_machine() -> Iterator[Check]:
    """System, Python and versions."""
    found = versions()
    yield Check("machine", None, f"{platform.system()} {platform.machine()}")
    yield Check("Python", sys.version_info >= (3, 11), found["python"])
    packages = [f"{name} {version}" for name, version in found.items() if name != "python"]
    yield Check("packages", None, ", ".join(packages))


def check_computing() -> Iterator[Check]:
    """Device, kernels, number format, threads and their wait policy of the networks."""
    import torch

    from ...core.device import describe, resolve_device
    from ...pose_estimator.networks.fused import can_fuse_in

    yield Check("device", None, f"auto means {describe(resolve_device('auto'))}")
    has = f"{processor_name()}, {available_cores()} cores, {instructions()}"
    yield Check("processor", None, has)
    limited = f", limited by {limits()}" if limits() else ""
    numbers = number_format()
    fused = "in one step with" if can_fuse_in(getattr(torch, numbers)) else "apart from"
    text = f"on the processor PyTorch uses its {torch.backends.cpu.get_cpu_capability()} kernels"
    text += f"{limited}; networks compute in {numbers}, convolutions {fused} what follows them"
    yield Check("kernels", None, text)
    yield Check(
        "threads", None, f"{torch.get_num_threads()} by default; they {describe_wait_policy()}"
    )


def check_objects() -> Check:
    """Whether every shipped object loads."""
    from ...assets import OBJECT_NAMES, load_object

    try:
        faces = sum(len(load_object(name).faces) for name in OBJECT_NAMES)
    except (ValueError, OSError) as error:
        return Check("objects", False, str(error))
    return Check("objects", True, f"{len(OBJECT_NAMES)} objects, {faces} faces")


def check_estimator(method: str) -> Check:
    """Loads the shipped weights, checks that a pose is finite and times it, on device ``auto``.

    Each estimate gets new views, so that nothing is cached.
    """
    from ...core.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K, View
    from ...pose_estimator import load

    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (*LINEMOD_IMAGE_SIZE, 3), dtype=np.uint8)
    aside = np.eye(4)
    aside[0, 3] = -0.1
    took = []
    try:
        estimator = load(method)
        name = estimator.object_names[0]
        for _ in range(_WARM_UP + _ESTIMATES):
            views = [View(image, LINEMOD_K, pose) for pose in (np.eye(4), aside)]
            started = perf_counter()
            answer = estimator.estimate(views, name)
            took.append(perf_counter() - started)
    except (ValueError, OSError) as error:
        return Check(f"estimator {method}", False, str(error))
    if not np.isfinite(answer.T_cam_obj).all():
        return Check(f"estimator {method}", False, "the pose is not finite")
    milliseconds = 1e3 * np.median(took[_WARM_UP:])
    text = f"{len(estimator.object_names)} objects, {milliseconds:.0f} ms a pair"
    return Check(f"estimator {method}", True, f"{text}, median of {_ESTIMATES}")


def checks(quick: bool) -> Iterator[Check]:
    """Runs all checks, in the order in which they are printed."""
    if not quick:
        yield from check_machine()
    yield check_opengl()
    if not quick:
        yield from check_computing()
        yield check_objects()
        yield check_estimator("single")
        yield check_estimator(DEFAULT_METHOD)


def doctor(config: DoctorConfig) -> int:
    """Prints every check; returns 0, or 1 if one failed."""
    done = []
    for check in checks(config.quick):
        mark = {True: "ok", False: "FAIL", None: ""}[check.passed]
        print(f"{mark:>5}  {check.name}: {check.text}", flush=True)
        done.append(check)
    if config.json is not None:
        records = [
            {"metric": "passed", "value": int(check.passed), "unit": "1", "check": check.name}
            for check in done
            if check.passed is not None
        ]
        write_results(config.json, records, command="doctor", seed=None)
    return int(any(check.passed is False for check in done))
