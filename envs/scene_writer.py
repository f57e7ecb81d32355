"""One scene of a generated dataset: arranged, seen by its cameras, annotated, written."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ..assets import load_objects
from ..assets.object_model import ObjectModel
from ..pose_estimator.bop import BopAnnotation, read_dataset, read_models_info
from ..pose_estimator.bop_pairs import BopPair
from ..pose_estimator.bop_writer import NO_BOX, BopFrame, bounding_box, write_scene
from ..pose_estimator.geometry import (
    LINEMOD_IMAGE_SIZE,
    LINEMOD_K,
    invert,
    project,
    transform,
)
from .camera import CameraRange
from .randomization import Randomization
from .renderer import SceneRenderer
from .scene import Scene, SceneConfig
from .sensor import apply_sensor
from .view_spread import spread_views, viewing_angle

if TYPE_CHECKING:
    from .generate import GenerateConfig

CENTRE_JITTER = 0.02
"""Standard deviation in metres of the point that the further views go round, beside the target."""


class SceneMaker:
    """Makes the scenes of one dataset; holds a compiled world for each kind of scene.

    Args:
        config: what the dataset is.
    """

    def __init__(self, config: GenerateConfig) -> None:
        self._config = config
        self._objects = load_objects(config.objects or None)
        self._randomization = Randomization() if config.randomize else Randomization.none()
        self._renderers: dict[str, tuple[Scene, SceneRenderer]] = {}
        self._K = scaled_intrinsics(config.height, config.width)

    def make(self, scene_id: int) -> None:
        """Renders scene ``scene_id`` and writes its folder."""
        config = self._config
        rng = np.random.default_rng(np.random.SeedSequence([config.seed, scene_id]))
        names = tuple(self._objects)
        kind = config.scene
        if kind == "mixed":
            kind = ("linemod", "occlusion")[scene_id // len(names) % 2]
        frames = self._frames(kind, names[scene_id % len(names)], rng)
        write_scene(config.out, config.split, scene_id, frames, config.jpeg_quality or None)

    def close(self) -> None:
        """Frees the GL contexts."""
        for _, renderer in self._renderers.values():
            renderer.close()
        self._renderers = {}

    def __enter__(self) -> SceneMaker:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _world(self, kind: str) -> tuple[Scene, SceneRenderer]:
        if kind not in self._renderers:
            scene = Scene(self._objects, SceneConfig(kind=kind), self._randomization)
            renderer = SceneRenderer(scene, self._config.height, self._config.width)
            self._renderers[kind] = scene, renderer
        return self._renderers[kind]

    def _frames(self, kind: str, target: str, rng: np.random.Generator) -> Iterator[BopFrame]:
        config, randomization = self._config, self._randomization
        scene, renderer = self._world(kind)
        state = scene.reset(rng, target)
        cameras = CameraRange(
            roll=randomization.camera_roll, look_at_noise=randomization.look_at_noise
        )
        centre = state.T_world_obj[target][:3, 3] + rng.normal(0.0, CENTRE_JITTER, 3)
        low, high = np.deg2rad(config.view_angles)
        views = spread_views(rng, state.T_cam_world, centre, config.views - 1, (low, high), cameras)
        for T_cam_world in (state.T_cam_world, *views):
            frame = renderer.render(T_cam_world, self._K, depth=config.depth, masks=True)
            assert frame.instances is not None
            annotations, masks = [], []
            for index, name in enumerate(frame.object_names):
                mask = frame.instances == index
                T_cam_obj = T_cam_world @ state.T_world_obj[name]
                annotations.append(self._annotate(scene, name, mask, T_cam_world, T_cam_obj))
                masks.append(mask)
            yield BopFrame(
                rgb=apply_sensor(frame.rgb, randomization.sensor, rng),
                K=self._K,
                T_cam_world=T_cam_world,
                annotations=annotations,
                masks=masks if config.masks else None,
                depth=frame.depth,
            )

    def _annotate(
        self,
        scene: Scene,
        name: str,
        mask: np.ndarray,
        T_cam_world: np.ndarray,
        T_cam_obj: np.ndarray,
    ) -> BopAnnotation:
        """The silhouette is drawn alone, in a window that also reaches beyond the picture."""
        model = self._objects[name]
        visible = int(np.count_nonzero(mask))
        left, top, width, height = silhouette_window(model, T_cam_obj, self._K, mask.shape)
        whole, box = visible, bounding_box(mask)
        if width > 0 and height > 0:
            window_K = self._K - [[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]]
            geom = scene.world.object_geoms[scene.world.object_names.index(name)]
            alone = scene.graphics.silhouette(geom, T_cam_world, window_K, height, width)
            x, y, *size = bounding_box(alone)
            box = NO_BOX if (x, y, *size) == NO_BOX else (x + left, y + top, size[0], size[1])
            whole = max(whole, int(np.count_nonzero(alone)))
        return BopAnnotation(
            obj_id=model.obj_id,
            T_cam_obj=T_cam_obj,
            visibility=visible / whole if whole else 0.0,
            bbox_visib=bounding_box(mask),
            bbox_obj=box,
            px_count_visib=visible,
            px_count_all=whole,
        )


def silhouette_window(
    model: ObjectModel, T_cam_obj: np.ndarray, K: np.ndarray, shape: tuple[int, ...]
) -> tuple[int, int, int, int]:
    """Left, top, width, height in pixels of a window that holds the object's silhouette.

    As in BOP, what is more than a picture's width or height outside of the picture is cut off.
    An object that reaches behind the camera gets the largest window.
    """
    height, width = shape
    limits = np.array([[-width, -height], [2 * width, 2 * height]])
    points = transform(T_cam_obj, model.vertices)
    if points[:, 2].max() <= 0.0:
        return 0, 0, 0, 0
    low, high = limits
    if points[:, 2].min() > 0.01:
        uv = project(points, K)
        low = np.clip(np.floor(uv.min(axis=0)) - 1, *limits).astype(int)
        high = np.clip(np.ceil(uv.max(axis=0)) + 2, *limits).astype(int)
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def scaled_intrinsics(height: int, width: int) -> np.ndarray:
    """LineMOD's camera matrix (3, 3) for pictures of another size."""
    scale = np.array([width / LINEMOD_IMAGE_SIZE[1], height / LINEMOD_IMAGE_SIZE[0]])
    K = LINEMOD_K.copy()
    K[[0, 1], [0, 1]] *= scale
    K[:2, 2] = scale * (K[:2, 2] + 0.5) - 0.5  # pixel centres are whole numbers
    return K


def two_view_pairs(config: GenerateConfig) -> Iterator[BopPair]:
    """The pairs (reference view, further view) of the written scenes, read back from the disk.

    A pair is listed if the angle at the target lies within ``config.pair_angles``.
    """
    obj_ids = list(read_models_info(config.out))
    dataset = read_dataset(config.out, config.split)
    for scene_id in range(config.scenes):
        images = dataset.scene(scene_id)
        first = images[0]
        target = obj_ids[scene_id % len(obj_ids)]
        assert first.T_cam_world is not None
        T_world_cam = invert(first.T_cam_world)
        for image_id in range(1, config.views):
            second = images[image_id].T_cam_world
            assert second is not None
            baselines = {
                a.obj_id: np.rad2deg(
                    viewing_angle(first.T_cam_world, second, (T_world_cam @ a.T_cam_obj)[:3, 3])
                )
                for a in first.annotations
            }
            if config.pair_angles[0] <= baselines[target] <= config.pair_angles[1]:
                yield BopPair(
                    scene_id=scene_id,
                    ref_image_id=0,
                    second_image_id=image_id,
                    T_second_ref=second @ T_world_cam,
                    baselines_deg=baselines,
                    target_obj_id=target,
                )
