"""Sets up, renders, annotates and writes one scene of a generated dataset."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...pose_estimator.bop.coco import COCO_FILE, write_coco
from ...pose_estimator.bop.writer import BopFrame, scene_folder, write_scene
from ..simulation.annotation import annotate
from ..simulation.camera import CameraRange
from ..simulation.depth_sensor import DepthSensorConfig, apply_depth_sensor
from ..simulation.intrinsics import scaled_intrinsics
from ..simulation.randomization import Randomization
from ..simulation.renderer import SceneRenderer
from ..simulation.scene import Scene, SceneConfig, SceneState
from ..simulation.sensor import SensorState, apply_sensor
from ..simulation.trajectories.sequence import CENTER_JITTER, sample_path
from ..simulation.trajectories.stereo import rig_frames
from ..simulation.trajectories.view_spread import spread_views
from .checksums import SUMS_FILE, write_sums
from .config import GenerateConfig
from .dataset_folder import remove_leftovers
from .scene_plan import ScenePlan, dataset_objects, plan_scene


class SceneWriter:
    """Generates the scenes of one dataset; caches a compiled world per kind of scene."""

    def __init__(self, config: GenerateConfig) -> None:
        self._config = config
        self._objects = dataset_objects(config)
        strong = config.domain_randomization == "strong"
        randomization = Randomization.strong() if strong else Randomization()
        self._randomization = randomization if config.randomize else Randomization.none()
        self._renderers: dict[str, tuple[Scene, SceneRenderer]] = {}
        self._K = scaled_intrinsics((config.height, config.width), "stretch")

    def make(self, scene_id: int) -> None:
        """Renders scene ``scene_id`` if it is missing, and adds missing files.

        The checksums are written last: a scene that has them is finished.
        """
        config = self._config
        folder = scene_folder(config.out, config.split, scene_id)
        if not folder.exists():
            rng = np.random.default_rng(np.random.SeedSequence([config.seed, scene_id]))
            frames = self._frames(plan_scene(config, scene_id, tuple(self._objects)), rng)
            write_scene(config.out, config.split, scene_id, frames, config.jpeg_quality or None)
        elif is_finished(config, scene_id):
            return
        remove_leftovers(folder)
        if config.coco and not (folder / COCO_FILE).exists():
            (folder / SUMS_FILE).unlink(missing_ok=True)
            write_coco(folder, [model.obj_id for model in self._objects.values()])
        write_sums(folder)

    def close(self) -> None:
        """Frees the GL contexts."""
        for _, renderer in self._renderers.values():
            renderer.close()
        self._renderers = {}

    def _world(self, kind: str) -> tuple[Scene, SceneRenderer]:
        if kind not in self._renderers:
            scene = Scene(self._objects, SceneConfig(kind=kind), self._randomization)
            renderer = SceneRenderer(scene, self._config.height, self._config.width)
            self._renderers[kind] = scene, renderer
        return self._renderers[kind]

    def _frames(self, plan: ScenePlan, rng: np.random.Generator) -> Iterator[BopFrame]:
        config, randomization = self._config, self._randomization
        full = config.annotations == "full"
        scene, renderer = self._world(plan.kind)
        (depth_rng,) = rng.spawn(1)  # a separate stream, so that depth changes nothing else
        state = scene.reset(rng, plan.target)
        path = self._path(scene, state, plan, rng)
        # The frames of a sequence or rig share the sensor parameters.
        shared = plan.length is not None or plan.stereo
        sensor = SensorState.sample(randomization.sensor, rng) if shared else None
        for image_id in plan.frames:
            T_cam_world = path[image_id]
            frame = renderer.render(T_cam_world, self._K, depth=config.depth, masks=True)
            truth = annotate(scene, frame, T_cam_world, self._K)
            depth = frame.depth
            if depth is not None and config.depth_noise:
                depth = apply_depth_sensor(depth, self._K, DepthSensorConfig(), depth_rng)
            valid = None
            if depth is not None and full:
                valid = [int(np.count_nonzero(mask & (depth > 0))) for mask in truth.silhouettes]
            if sensor is None:
                rgb = apply_sensor(frame.rgb, randomization.sensor, rng)
            else:
                rgb = sensor.resample_blur(randomization.sensor, rng).apply(frame.rgb, rng)
            yield BopFrame(
                rgb=rgb,
                K=self._K,
                T_cam_world=T_cam_world,
                annotations=truth.annotations,
                masks=truth.masks if config.masks else None,
                depth=depth,
                image_id=image_id,
                silhouettes=truth.silhouettes if config.masks and full else None,
                px_counts_valid=valid,
            )

    def _path(
        self, scene: Scene, state: SceneState, plan: ScenePlan, rng: np.random.Generator
    ) -> Sequence[np.ndarray]:
        """Returns T_cam_world (4, 4) of every frame, also of those that are not rendered."""
        cameras = CameraRange(
            roll=self._randomization.camera_roll, look_at_noise=self._randomization.look_at_noise
        )
        if plan.length is not None:
            return list(sample_path(scene, rng, plan.length, cameras))
        center = state.T_world_obj[plan.target][:3, 3] + rng.normal(0.0, CENTER_JITTER, 3)
        low, high = np.deg2rad(self._config.view_angles)
        count = self._config.views // 2 if plan.stereo else self._config.views
        views = spread_views(rng, state.T_cam_world, center, count - 1, (low, high), cameras)
        views = [state.T_cam_world, *views]
        return rig_frames(views, self._config.stereo_baseline) if plan.stereo else views


def is_finished(config: GenerateConfig, scene_id: int) -> bool:
    """Returns whether all files of a scene are written."""
    folder = scene_folder(config.out, config.split, scene_id)
    wanted = (SUMS_FILE, COCO_FILE) if config.coco else (SUMS_FILE,)
    return all((folder / name).exists() for name in wanted)
