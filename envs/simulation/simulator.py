"""Simulates the scene of an episode: sets it up and renders images of it.

An environment runs its simulator in its own process, ``TwoViewPoseVectorEnv`` in worker processes
(``vector/remote_simulator.py``). Calls depend only on their arguments and the last reset.
"""

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
"""Maximum number of views of an episode, the reference view included."""


@dataclass(frozen=True, eq=False)
class SceneRequest:
    """Which scene to set up.

    Attributes:
        seed: of everything that is sampled.
        object_name: the target; None: sampled.
        reference_camera: T_cam_world, (4, 4); None: sampled.
    """

    seed: int
    object_name: str | None = None
    reference_camera: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class SceneInfo:
    """Ground truth and reference view of a scene.

    Attributes:
        object_name: the target.
        T_world_obj: its pose, (4, 4).
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
        scene: what is on the table.
        randomization: of lights, textures and sensor.
        resolution: height and width of the images, pixels; cropped to other aspect ratios than
            LineMOD's, see :func:`~.intrinsics.scaled_intrinsics`.
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
        """Sets up a new scene and renders the reference view."""
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
            number: of the view in its episode, from 0; selects the stream of the sensor noise.
        """
        image = self._renderer.render(T_cam_world, self._K).rgb
        return apply_sensor(image, self._sensor, episode_generators(self._seed)[2 + number])

    def visibility_from(self, T_cam_world: np.ndarray) -> float:
        """Returns the visible fraction of the target from a camera (4, 4)."""
        state = self._scene.state
        assert state is not None
        return float(self._scene.probe_visibility([state.target], T_cam_world)[0])

    def submit(self, method: str, *arguments: Any) -> Callable[[], Any]:
        """Defers a method call; calling the returned function runs it and returns its result."""
        return partial(getattr(self, method), *arguments)

    def close(self) -> None:
        """Frees the GL context; the next image opens a new one."""
        self._renderer.close()


def episode_generators(scene_seed: int) -> list[np.random.Generator]:
    """Returns one random stream per purpose: draws from one never change another.

    They are for the scene, the pose noise, and the sensor in each of ``MAX_VIEWS`` views.
    """
    return np.random.default_rng(scene_seed).spawn(2 + MAX_VIEWS)
