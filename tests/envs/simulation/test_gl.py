"""OpenGL back-ends that are missing, and drawing in another process."""

from __future__ import annotations

import multiprocessing
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from helpers import workers
from two_view_pose.envs.simulation import gl

MISSING = """
import sys
class Missing:
    def find_spec(self, name, *_):
        if name in {names}: raise AttributeError('no library for ' + name)
sys.meta_path.insert(0, Missing())
"""
"""A program that makes back-ends impossible to import."""

OPEN = "from two_view_pose.envs.simulation import gl; gl.open_context(64, 64)"


def errors(program: str, **environment: str) -> str:
    """What a Python program prints to its standard error."""
    inherited = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    return subprocess.run(
        [sys.executable, "-c", program],
        env=inherited | environment,
        capture_output=True,
        text=True,
        timeout=100,
    ).stderr


def test_without_opengl_the_error_says_what_to_install() -> None:
    program = MISSING.format(names=("mujoco.egl", "mujoco.osmesa")) + OPEN
    text = r"GraphicsUnavailable: .*apt-get install .*egl: .*osmesa: "
    assert re.search(text, errors(program))


def test_rendering_that_is_disabled_is_an_error() -> None:
    assert re.search("GraphicsUnavailable: MUJOCO_GL=off disables", errors(OPEN, MUJOCO_GL="off"))


def test_a_process_forked_after_rendering_refuses_to_render() -> None:
    program = f"""
import os, sys
{OPEN}
if os.fork():
    os.wait()
else:
    try:
        gl.open_context(64, 64)
    except gl.GraphicsUnavailable as error:
        print(error, file=sys.stderr, flush=True)
os._exit(0)  # OpenGL's threads, which the child lacks, would be waited for
"""
    assert "this process was forked" in errors(program)


@pytest.mark.slow
def test_a_named_back_end_that_is_missing_is_named_in_the_error() -> None:
    program = MISSING.format(names=("mujoco.osmesa",))
    program += "import two_view_pose.envs.simulation.scene"
    stderr = errors(program, MUJOCO_GL="osmesa")
    assert "GraphicsUnavailable" in stderr
    assert "apt-get install -y libosmesa6" in stderr


@pytest.mark.slow
def test_a_spawned_worker_renders_the_same_image() -> None:
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    worker = context.Process(target=workers.render_duck, args=(queue,))
    worker.start()
    theirs = queue.get(timeout=60)
    worker.join()
    here: multiprocessing.Queue = multiprocessing.get_context("spawn").Queue()
    workers.render_duck(here)
    np.testing.assert_array_equal(here.get(timeout=10), theirs)


def test_a_context_that_is_in_use_in_another_thread_is_an_error() -> None:
    with ThreadPoolExecutor(1) as thread:
        context = thread.submit(gl.open_context, 64, 64).result()
        if gl.backend() == "egl":
            with pytest.raises(gl.GraphicsUnavailable, match="but only in one at a time"):
                gl.make_current(context)
        thread.submit(gl.release_current).result()
        gl.make_current(context)
        context.free()
