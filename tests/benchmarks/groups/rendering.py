"""Our image with depth and masks, compared with three renders of ``mujoco.Renderer``."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from PIL import Image
from two_view_pose import assets
from two_view_pose.core.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K
from two_view_pose.envs.simulation.renderer import SceneRenderer
from two_view_pose.envs.simulation.scene import Scene

from ..config import BenchConfig
from ..stopwatch import Record, ratio


def measure(config: BenchConfig) -> Iterator[Record]:
    """RGB alone, and RGB, depth and masks, of one view of 640x480: same scene and camera."""
    scene, T_cam_world = drawn_scene(config.seed)
    ours = SceneRenderer(scene)
    draw = partial(ours.render, T_cam_world)
    draw_all = partial(draw, depth=True, masks=True)
    frame = draw_all()
    rgb, everything = default_renderer(scene, T_cam_world)
    their_rgb, their_depth, their_geoms = everything()
    if config.images is not None:
        Image.fromarray(np.hstack([frame.rgb, their_rgb])).save(config.images)
    assert frame.depth is not None and frame.instances is not None
    levels = float(np.abs(frame.rgb.astype(int) - their_rgb).mean())
    depths = float(np.median(np.abs(frame.depth - their_depth)))
    masks = agreement(frame.instances, instances_of(their_geoms, scene.present_objects()[1]))
    work, against = "RGB frame, 640x480", "mujoco.Renderer defaults"
    record = ratio(work, against, draw, rgb, config.repeats, goal=3.0)
    yield {**record, "mean_difference_of_levels": levels}
    work, against = "RGB, depth and masks of one view, 640x480", f"{against}, three renders"
    record = ratio(work, against, draw_all, everything, config.repeats, goal=3.0)
    yield {
        **record,
        "mean_difference_of_levels": levels,
        "median_difference_of_depth": depths,
        "agreement_of_masks": masks,
    }
    ours.close()


def drawn_scene(seed: int) -> tuple[Scene, np.ndarray]:
    """A scene after a reset, with its OpenGL context closed, and its T_cam_world (4, 4)."""
    scene = Scene(assets.load_objects(None))
    state = scene.reset(np.random.default_rng(seed), scene.object_names[0])
    scene.graphics.close()
    return scene, state.T_cam_world


def default_renderer(
    scene: Scene, T_cam_world: np.ndarray
) -> tuple[Callable[[], np.ndarray], Callable[[], tuple[np.ndarray, ...]]]:
    """A ``mujoco.Renderer`` of the scene as it is, with MuJoCo's default quality.

    Returns:
        What draws RGB (H, W, 3), and what draws RGB, depth (H, W) and geoms with their kind
        (H, W, 2).
    """
    import mujoco
    from two_view_pose.envs.simulation.graphics import aim

    height, width = LINEMOD_IMAGE_SIZE
    renderer = mujoco.Renderer(default_model(scene, height, width), height, width)

    def rgb() -> np.ndarray:
        renderer.update_scene(scene.data)
        aim(renderer.scene, T_cam_world, LINEMOD_K, height, width)
        return renderer.render()

    def everything() -> tuple[np.ndarray, ...]:
        colors = rgb()
        renderer.enable_depth_rendering()
        depth = renderer.render()
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        segments = renderer.render()
        renderer.disable_segmentation_rendering()
        return colors, depth, segments

    return rgb, everything


def default_model(scene: Scene, height: int, width: int) -> Any:
    """A copy of the scene's model with MuJoCo's default quality, for images of one size."""
    import mujoco

    model = copy.copy(scene.world.model)
    quality = mujoco.MjSpec().compile().vis.quality
    model.vis.quality.offsamples = quality.offsamples
    model.vis.quality.shadowsize = quality.shadowsize
    model.vis.global_.offheight, model.vis.global_.offwidth = height, width
    return model


def instances_of(segments: np.ndarray, geoms: np.ndarray) -> np.ndarray:
    """Which object is at each pixel (H, W), or -1, from ids and kinds (H, W, 2) of MuJoCo.

    Args:
        segments: ids, and kinds of which only geoms count.
        geoms: the geom of each object, (N,).
    """
    import mujoco

    instances = np.full(segments.shape[:2], -1)
    is_geom = segments[..., 1] == int(mujoco.mjtObj.mjOBJ_GEOM)
    for number, geom in enumerate(geoms):
        instances[is_geom & (segments[..., 0] == geom)] = number
    return instances


def agreement(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Share of the pixels with an object, in either (H, W), that both give to the same one."""
    either = (ours >= 0) | (theirs >= 0)
    return int(np.count_nonzero((ours == theirs) & either)) / max(1, int(either.sum()))
