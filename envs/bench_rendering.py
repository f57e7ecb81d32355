"""A picture of ours, with depth and masks, beside a default ``mujoco.Renderer``'s three."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..pose_estimator.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K
from ..pose_estimator.stopwatch import Record, ratio

if TYPE_CHECKING:
    from .scene import Scene


def compare_renderers(repeats: int, seed: int, pictures: Path | None = None) -> list[Record]:
    """RGB alone, and RGB, depth and masks, of one view of 640x480: same scene and camera.

    Args:
        repeats: timed repeats of each side.
        seed: of the scene.
        pictures: where to write both sides' RGB, side by side.
    """
    from .. import assets
    from .renderer import SceneRenderer
    from .scene import Scene

    scene = Scene(assets.load_objects(None))
    state = scene.reset(np.random.default_rng(seed), scene.object_names[0])
    ours = SceneRenderer(scene)
    rgb, everything = default_renderer(scene, state.T_cam_world)
    frame = ours.render(state.T_cam_world, depth=True, masks=True)
    their_rgb, their_depth, their_geoms = everything()
    if pictures is not None:
        from PIL import Image

        Image.fromarray(np.hstack([frame.rgb, their_rgb])).save(pictures)
    assert frame.depth is not None and frame.instances is not None
    records = [
        ratio(
            "RGB frame, 640x480",
            "mujoco.Renderer defaults",
            lambda: ours.render(state.T_cam_world),
            rgb,
            repeats,
            goal=3.0,
        ),
        ratio(
            "RGB, depth and masks of one view, 640x480",
            "mujoco.Renderer defaults, three renders",
            lambda: ours.render(state.T_cam_world, depth=True, masks=True),
            everything,
            repeats,
            goal=3.0,
        ),
    ]
    ours.close()
    scene.close()
    same = {
        "mean_difference_of_levels": float(np.abs(frame.rgb.astype(int) - their_rgb).mean()),
        "median_difference_of_depth": float(np.median(np.abs(frame.depth - their_depth))),
        "agreement_of_masks": agreement(
            frame.instances, instances_of(their_geoms, scene.present_objects()[1])
        ),
    }
    return [
        {**records[0], "mean_difference_of_levels": same["mean_difference_of_levels"]},
        {**records[1], **same},
    ]


def default_renderer(
    scene: Scene, T_cam_world: np.ndarray
) -> tuple[Callable[[], np.ndarray], Callable[[], tuple[np.ndarray, ...]]]:
    """A ``mujoco.Renderer`` of the scene as it is, with MuJoCo's default quality.

    Returns:
        What draws RGB (H, W, 3), and what draws RGB, depth (H, W) and geoms with their kind
        (H, W, 2).
    """
    import mujoco

    from .graphics import aim

    height, width = LINEMOD_IMAGE_SIZE
    renderer = mujoco.Renderer(default_model(scene, height, width), height, width)

    def rgb() -> np.ndarray:
        renderer.update_scene(scene.data)
        aim(renderer.scene, T_cam_world, LINEMOD_K, height, width)
        return renderer.render()

    def everything() -> tuple[np.ndarray, ...]:
        colours = rgb()
        renderer.enable_depth_rendering()
        depth = renderer.render()
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        segments = renderer.render()
        renderer.disable_segmentation_rendering()
        return colours, depth, segments

    return rgb, everything


def default_model(scene: Scene, height: int, width: int) -> Any:
    """A copy of the scene's model with MuJoCo's default quality, for pictures of one size."""
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
