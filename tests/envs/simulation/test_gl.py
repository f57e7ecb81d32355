"""OpenGL back-ends that are missing, and drawing in another process."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys

import numpy as np
import pytest
from helpers import workers
from two_view_pose.envs.simulation import gl


def test_without_opengl_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(name: str) -> object:
        raise ImportError(f"no library for {name}")

    monkeypatch.setattr(gl, "_backend", None)
    monkeypatch.setattr(gl, "_process", None)
    monkeypatch.setattr(gl, "_forget_platform", lambda: None)
    monkeypatch.setattr(gl.importlib, "import_module", broken)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(gl.GraphicsUnavailable, match=r"apt-get install .*egl: .*osmesa: "):
        gl.open_context(64, 64)
    monkeypatch.setenv("MUJOCO_GL", "off")
    with pytest.raises(gl.GraphicsUnavailable, match="MUJOCO_GL"):
        gl.open_context(64, 64)
    monkeypatch.setattr(gl, "_process", -1)
    with pytest.raises(gl.GraphicsUnavailable, match="forked"):
        gl.open_context(64, 64)


@pytest.mark.slow
def test_a_named_back_end_that_is_missing_is_named_in_the_error() -> None:
    program = (
        "import sys\n"
        "class Missing:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'mujoco.osmesa': raise AttributeError('no library')\n"
        "sys.meta_path.insert(0, Missing())\n"
        "import two_view_pose.envs.simulation.scene\n"
    )
    environment = {**os.environ, "MUJOCO_GL": "osmesa"}
    run = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True
    )
    assert "GraphicsUnavailable" in run.stderr
    assert "apt-get install -y libosmesa6" in run.stderr


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
