"""Simulates the scene of an episode: what stands on the table, and images of it.

An environment has its simulator in its own process. ``TwoViewPoseVectorEnv`` has simulators in
others (:mod:`studio_workers`): one call sets up a scene, another renders it, and either says all
that it depends on, so that where it is carried out does not matter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ...assets.object_model import ObjectModel
from .intrinsics import scaled_intrinsics
from .randomization import Randomization
from .renderer import SceneRenderer
from .scene import Scene, SceneConfig
from .sensor import apply_sensor

MAX_VIEWS = 8
"""Views that one episode may have, the reference view included."""


@dataclass(frozen=True, eq=False)
class SceneRequest:
    """Which scene to set up.

    Attributes:
        seed: everything that is drawn follows from it.
        object_name: the target; None draws it.
        reference_camera: T_cam_world, (4, 4); None draws it.
    """

    seed: int
    object_name: str | None = None
    reference_camera: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class SceneInfo:
    """A scene that was set up.

    Attributes:
        object_name: the target.
        T_world_obj: its true pose, (4, 4).
        T_cam_world: the reference camera, (4, 4).
        visibility: visible fraction of the target in the reference view.
        image: the reference view, RGB uint8 (H, W, 3).
    """

    object_name: str
    T_world_obj: np.ndarray
    T_cam_world: np.ndarray
    visibility: float
    image: np.ndarray


class SceneSimulator:
    """Sets up scenes and renders them.

    Args:
        objects: by name; any of them can be the target.
        scene: what stands on the table.
        randomization: of lights, textures and sensor.
        resolution: height and width of the images, pixels; see
            :func:`~.intrinsics.scaled_intrinsics` for other proportions than LineMOD's.
    """

    def __init__(
        self,
        objects: Mapping[str, ObjectModel],
        scene: SceneConfig,
        randomization: Randomization,
        resolution: tuple[int, int],
    ) -> None:
        self._names = tuple(objects)
        self._sensor = randomization.sensor
        self._K = scaled_intrinsics(resolution, "crop")
        self._scene = Scene(objects, scene, randomization)
        self._renderer = SceneRenderer(self._scene, *resolution)
        self._seed = 0

    def reset(self, request: SceneRequest) -> SceneInfo:
        """Sets up a scene in place of the one before, and renders the reference view."""
        rng = episode_generators(request.seed)[0]
        drawn = self._names[int(rng.integers(len(self._names)))]
        name = drawn if request.object_name is None else request.object_name
        state = self._scene.reset(rng, name, request.reference_camera)
        self._seed = request.seed
        T_cam_world, visibility = state.T_cam_world, float(state.visibility)
        image = self.render(T_cam_world, 0)
        return SceneInfo(name, state.T_world_obj[name], T_cam_world, visibility, image)

    def render(self, T_cam_world: np.ndarray, number: int) -> np.ndarray:
        """Renders the scene: RGB uint8 (H, W, 3).

        Args:
            T_cam_world: the camera, (4, 4).
            number: of the view in its episode, from 0; the sensor's noise depends on it.
        """
        image = self._renderer.render(T_cam_world, self._K).rgb
        return apply_sensor(image, self._sensor, episode_generators(self._seed)[2 + number])

    def visibility_from(self, T_cam_world: np.ndarray) -> float:
        """Visible fraction of the target from a camera (4, 4)."""
        state = self._scene.state
        assert state is not None
        return float(self._scene.probe_visibility([state.target], T_cam_world)[0])

    def submit(self, method: str, *arguments: Any) -> Callable[[], Any]:
        """Prepares a call of a method; what is returned carries it out and returns its result."""
        return partial(getattr(self, method), *arguments)

    def close(self) -> None:
        """Frees the GL context; the next image opens another."""
        self._renderer.close()


def episode_generators(scene_seed: int) -> list[np.random.Generator]:
    """One stream for each purpose, so that what one of them draws never moves another.

    Returns:
        For the scene, for the error of the poses that the estimator is given, and for the sensor
        in each of ``MAX_VIEWS`` views.
    """
    return np.random.default_rng(scene_seed).spawn(2 + MAX_VIEWS)
