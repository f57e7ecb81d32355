"""What test processes run; in a module of its own, which a spawned process can import."""

from __future__ import annotations

import multiprocessing

import numpy as np
from two_view_pose import assets
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.worker_pool import memory_in_use
from two_view_pose.envs.simulation.randomization import Randomization
from two_view_pose.envs.simulation.renderer import SceneRenderer
from two_view_pose.envs.simulation.scene import Scene, SceneConfig
from two_view_pose.envs.two_view_pose import TwoViewPoseEnv

ALONE = SceneConfig(clutter_objects=(0, 0), plain_shapes=(0, 0))


def render_duck(queue: multiprocessing.Queue) -> None:
    """Puts an image of a duck alone on the table into the queue."""
    scene = Scene(assets.load_objects(["duck"]), ALONE, Randomization.none())
    with SceneRenderer(scene, 48, 64) as renderer:
        state = scene.reset(np.random.default_rng(0), "duck")
        queue.put(renderer.render(state.T_cam_world).rgb)


def memory_of_episodes(objects: dict[str, ObjectModel], episodes: int, every: int) -> list[int]:
    """Plays episodes of one step; the bytes that the process held after each ``every`` of them."""
    env = TwoViewPoseEnv(objects=objects, estimator=None, resolution=(120, 160))
    env.action_space.seed(0)
    env.reset(seed=0)
    held = []
    for episode in range(1, episodes + 1):
        env.step(env.action_space.sample())
        env.reset()
        if episode % every == 0:
            held.append(memory_in_use())
    env.close()
    return held
