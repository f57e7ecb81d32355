"""Episodes of pixels without an estimator, compared with other renderers of the same meshes.

Both sides draw 84x84 images of one scene of MuJoCo. Gymnasium's and dm_control's way is one step
of physics and one image; an episode of ours is a reset, which sets up a new scene and takes the
reference view, and one step, which takes the second view.

Each side has a process of its own and waits while the other works: Gymnasium and dm_control assume
an exclusive OpenGL context, and in one process would draw into ours.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from ..config import BenchConfig
from ..stopwatch import WARM_UP, Record, make_record, missing, seconds
from .rendering import default_model, drawn_scene

SIDE = 84
CAMERA = {"distance": 1.0, "azimuth": 90.0, "elevation": -45.0}
"""Of Gymnasium's free camera, from the middle of the table: meters and degrees. It sees about as
much of the scene as ours does."""


class Side(NamedTuple):
    """What one side does.

    Attributes:
        reset: begins an episode; of a peer it returns the image, (84, 84, 3).
        step: one step, likewise.
        close: frees everything.
    """

    reset: Callable[[], Any]
    step: Callable[[], Any]
    close: Callable[[], Any]


def measure(config: BenchConfig) -> Iterator[Record]:
    """A step and a whole episode of ``TwoViewPose-v0`` against both others."""
    for name, (_, install) in PEERS.items():
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, spawn) as ours, ProcessPoolExecutor(1, spawn) as theirs:
            failure = theirs.submit(begin, name, config.seed).result()
            if failure is not None:
                yield missing(name, failure, install)
                continue
            ours.submit(begin, OURS, config.seed).result()
            rounds = [
                [side.submit(time_episode).result() for side in (ours, theirs)]
                for _ in range(config.repeats + WARM_UP)
            ]
            for side in (ours, theirs):
                side.submit(end).result()
        yield from records(name, np.array(rounds[WARM_UP:]))


def records(name: str, times: np.ndarray) -> list[Record]:
    """Compares a step with a step, and an episode with as many images.

    Args:
        name: of the peer.
        times: seconds (N, 2, 2): of our reset and step, and of the peer's.
    """
    size = f"{SIDE}x{SIDE}"
    steps, episodes = times[..., 1], times.sum(axis=2)
    compared = (
        ("env.step", "mj_step, image", steps),
        ("reset (a new scene) and step", "reset, image, mj_step, image", episodes),
    )
    return [
        make_record(
            f"pixels, {ours}, {size}",
            f"{name}: {theirs}",
            seconds[:, 0].tolist(),
            seconds[:, 1].tolist(),
            goal=2.0,
        )
        for ours, theirs, seconds in compared
    ]


def our_pixels(seed: int) -> Side:
    """Reset and step of ``TwoViewPose-v0``."""
    env = pixels_env(seed)
    return Side(env.reset, lambda: env.step(env.action_space.sample()), env.close)


def pixels_env(seed: int) -> gym.Env:
    """``TwoViewPose-v0`` with small images and no estimator, after its first reset."""
    env = gym.make(
        "two_view_pose:TwoViewPose-v0",
        estimator=None,
        resolution=(SIDE, SIDE),
        image_size=SIDE,
    )
    env.action_space.seed(seed)
    env.reset(seed=seed)
    return env


def gymnasium_pixels(seed: int) -> Side:
    """Reset and step as a ``MujocoEnv`` does them, seen by Gymnasium's own renderer."""
    import mujoco
    from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer

    scene, _ = drawn_scene(seed)
    model, start = default_model(scene, SIDE, SIDE), scene.data.qpos.copy()
    data = mujoco.MjData(model)
    renderer = MujocoRenderer(model, data, {**CAMERA, "lookat": np.zeros(3)}, SIDE, SIDE)

    def reset() -> Any:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = start
        mujoco.mj_forward(model, data)
        return renderer.render("rgb_array")

    def step() -> Any:
        mujoco.mj_step(model, data)
        return renderer.render("rgb_array")

    return Side(reset, step, renderer.close)


def dm_control_pixels(seed: int) -> Side:
    """Reset and step as dm_control's ``Physics`` does them, with ``physics.render``."""
    from dm_control import mujoco as dm
    from dm_control.mujoco import wrapper

    scene, _ = drawn_scene(seed)
    start = scene.data.qpos.copy()
    physics = dm.Physics.from_model(wrapper.MjModel(default_model(scene, SIDE, SIDE)))

    def reset() -> Any:
        with physics.reset_context():
            physics.data.qpos[:] = start
        return physics.render(SIDE, SIDE)

    def step() -> Any:
        physics.step()
        return physics.render(SIDE, SIDE)

    return Side(reset, step, physics.free)


OURS = "Two-View Pose"
PEERS: dict[str, tuple[Callable[[int], Side], str]] = {
    "Gymnasium's MujocoRenderer": (gymnasium_pixels, "pip install imageio"),
    "dm_control": (dm_control_pixels, "pip install dm_control"),
}
"""How each peer is made, and how it is installed."""

_side: Side | None = None


def begin(name: str, seed: int) -> str | None:
    """In a child: makes one side ready. Returns why it does not work, if it does not."""
    global _side
    if name == OURS:
        _side = our_pixels(seed)
        return None
    try:
        _side = PEERS[name][0](seed)
        image = _side.reset()
    except Exception as error:  # of others' code, in which anything can be missing
        return f"{type(error).__name__}: {error}"
    if image.shape != (SIDE, SIDE, 3) or image.std() < 1:
        return f"it draws nothing: {image.shape}, deviation {image.std():.1f}"
    return None


def time_episode() -> tuple[float, float]:
    """In a child: seconds of one reset and one step."""
    assert _side is not None
    return seconds(_side.reset), seconds(_side.step)


def end() -> None:
    """In a child: frees what it holds, while OpenGL is still there."""
    if _side is not None:
        _side.close()
