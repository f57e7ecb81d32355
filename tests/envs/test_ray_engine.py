"""A Ray cluster makes the same scenes, also where it loses a worker on the way."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest
from small_sets import apes, file_bytes
from two_view_pose.envs.generate import GenerateConfig, generate

needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed")


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> GenerateConfig:
    return apes(tmp_path_factory.mktemp("data") / "set", scenes=5)


def descendants(process: int) -> dict[int, str]:
    """Numbers and names of the processes that a process started, and those that they did."""
    parents, names = {}, {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            status = (path / "status").read_text()
            names[int(path.name)] = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:  # it has ended
            continue
        parents[int(path.name)] = int(status.split("PPid:")[1].split()[0])
    found = {process}
    while more := {p for p, parent in parents.items() if parent in found} - found:
        found |= more
    return {p: names[p] for p in found - {process} if p in names}


@needs_ray
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")
def test_a_worker_that_is_killed_costs_nothing(
    config: GenerateConfig, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    again = replace(config, out=Path("set"), workers=2, ray="local")  # a path of this folder
    killed: list[int] = []

    def kill_one() -> None:
        while not list(Path(tmp_path, "set").glob("train_pbr/.*.partial")):
            time.sleep(0.02)
        busy = [p for p, name in descendants(os.getpid()).items() if "ray::_make_one" in name]
        os.kill(busy[0], signal.SIGKILL)
        killed.append(busy[0])

    thread = threading.Thread(target=kill_one, daemon=True)
    thread.start()
    generate(again)
    thread.join(1)
    assert killed
    assert file_bytes(tmp_path / "set") == file_bytes(config.out)


@pytest.mark.skipif(find_spec("ray") is not None, reason="Ray is installed")
def test_without_ray_the_message_says_what_to_install(config: GenerateConfig, tmp_path) -> None:
    with pytest.raises(ValueError, match=r"pip install 'two-view-pose\[ray\]'"):
        generate(replace(config, out=tmp_path / "set", ray="local"))
