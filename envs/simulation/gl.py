"""Selects the back-end for headless rendering: EGL where it works, else OSMesa.

``MUJOCO_GL`` overrides it. PyOpenGL binds itself to one platform when it is first imported, so it
is imported with the first image.
"""

import importlib
import os
import platform
import sys
from typing import Any

_NAMED = {"egl": "egl", "osmesa": "osmesa", "glfw": "glfw", "glx": "glfw"}
_LIBRARIES = {"egl": "libegl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}
INSTALL_HINT = "apt-get install -y libegl1 libgl1-mesa-dri   (or: apt-get install -y libosmesa6)"

_backend: str | None = None
_process: int | None = None


class GraphicsUnavailable(OSError):
    """No OpenGL library for headless rendering was found; the message says what to install."""


try:
    import mujoco as mujoco
except Exception as error:  # importing MuJoCo opens the library that MUJOCO_GL names
    _named = os.environ.get("MUJOCO_GL", "").lower().strip()
    if _named not in _LIBRARIES:
        raise
    raise GraphicsUnavailable(
        f"MUJOCO_GL={_named}, but its library cannot be loaded ({error}). Install it with "
        f"apt-get install -y {_LIBRARIES[_named]}, or unset MUJOCO_GL"
    ) from error


def backend() -> str | None:
    """Returns the back-end in use ("egl", "osmesa", ...), or None before the first image."""
    return _backend


def open_context(width: int, height: int) -> Any:
    """Opens a MuJoCo GL context (it has ``make_current`` and ``free``).

    Args:
        width: of the largest image, pixels (OSMesa needs it).
        height: of the largest image, pixels.

    Raises:
        GraphicsUnavailable: if no back-end works, or the one that MUJOCO_GL names does not, or in
            a process forked from one that had rendered (OpenGL's threads do not survive a fork,
            and rendering would deadlock).
    """
    global _backend, _process
    if _process is not None and _process != os.getpid():
        raise GraphicsUnavailable(
            "this process was forked from one that had already rendered, which OpenGL does not "
            'support: start workers with "spawn" or "forkserver", or before the first image'
        )
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    if _backend is not None:
        candidates = [_backend]
    elif wanted in ("disable", "disabled", "off", "false", "0"):
        raise GraphicsUnavailable(f"MUJOCO_GL={wanted} disables rendering; unset it")
    elif platform.system() != "Linux":
        candidates = ["gl_context"]
    else:
        candidates = [_NAMED[wanted]] if wanted in _NAMED else ["egl", "osmesa"]
    reasons = []
    for name in candidates:
        try:
            context = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
            context.make_current()
        except Exception as error:  # PyOpenGL fails in many ways: try the next one
            reasons.append(f"{name}: {type(error).__name__}: {str(error).strip()[:200]}")
            if _backend is None:
                _forget_platform()
        else:
            _backend, _process = name, os.getpid()
            return context
    raise GraphicsUnavailable(
        f"no OpenGL for headless rendering. Install one: {INSTALL_HINT}. Tried {'; '.join(reasons)}"
    )


def make_current(context: Any) -> None:
    """Makes a context current in this thread.

    Raises:
        GraphicsUnavailable: if it is current in another one.
    """
    try:
        context.make_current()
    except Exception as error:  # PyOpenGL's
        raise GraphicsUnavailable(
            f"the OpenGL context cannot be used in this thread ({type(error).__name__}): an "
            "environment can be used in several threads, but only in one at a time"
        ) from error


def release_current() -> None:
    """Leaves no context current, since EGL refuses one that is current in another thread."""
    if _backend == "egl":
        module = sys.modules["mujoco.egl"]
        EGL = module.EGL
        EGL.eglMakeCurrent(
            module.EGL_DISPLAY, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT
        )


def _forget_platform() -> None:
    """Lets PyOpenGL choose its platform again at the next import."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in list(sys.modules):
        if name.split(".")[0] == "OpenGL" or name.startswith(("mujoco.egl", "mujoco.osmesa")):
            del sys.modules[name]
