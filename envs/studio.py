"""Where an episode's pictures are taken: a scene, and a camera in it.

The environment has its studio in its own process. ``TwoViewPoseVectorEnv`` has studios in others
(:mod:`studio_workers`): one order sets up a scene, another takes a picture of it, and either says
all that it depends on, so that where it is carried out does not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..assets.object_model import ObjectModel
from ..pose_estimator.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K
from .randomization import Randomization
from .renderer import SceneRenderer
from .scene import Scene, SceneConfig
from .sensor import apply_sensor

MOST_VIEWS = 8
"""Views that one episode may have, the reference view included."""


@dataclass(frozen=True, eq=False)
class StudioConfig:
    """What a studio is made of.

    Attributes:
        objects: by name; any of them can be the target.
        scene: what stands on the table.
        randomization: of lights, textures and sensor.
        resolution: height and width of the pictures, pixels.
    """

    objects: Mapping[str, ObjectModel]
    scene: SceneConfig
    randomization: Randomization
    resolution: tuple[int, int]

    @property
    def intrinsics(self) -> np.ndarray:
        """Camera matrix of the pictures, (3, 3); see :func:`scaled_intrinsics`."""
        return scaled_intrinsics(self.resolution)


@dataclass(frozen=True, eq=False)
class SceneOrder:
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
class Setup:
    """A scene that was set up.

    Attributes:
        object_name: the target.
        T_world_obj: its true pose, (4, 4).
        T_cam_world: the reference camera, (4, 4).
        visibility: visible fraction of the target in the reference view.
    """

    object_name: str
    T_world_obj: np.ndarray
    T_cam_world: np.ndarray
    visibility: float


class Studio(Protocol):
    """Sets up scenes and takes pictures of them."""

    def arrange(self, order: SceneOrder) -> Setup:
        """Sets up a scene in place of the one before."""
        ...

    def shoot(self, T_cam_world: np.ndarray, number: int) -> np.ndarray:
        """Takes a picture of the scene: RGB uint8 (H, W, 3).

        Args:
            T_cam_world: the camera, (4, 4).
            number: of the view in its episode, from 0; the sensor's noise depends on it.
        """
        ...

    def visibility_from(self, T_cam_world: np.ndarray) -> float:
        """Visible fraction of the target from a camera (4, 4)."""
        ...

    def close(self) -> None:
        """Frees what the studio holds."""
        ...


class LocalStudio:
    """A studio in this process."""

    def __init__(self, config: StudioConfig) -> None:
        self._config = config
        self._names = tuple(config.objects)
        self._K = config.intrinsics
        self._scene = Scene(config.objects, config.scene, config.randomization)
        self._renderer = SceneRenderer(self._scene, *config.resolution)
        self._seed = 0

    def arrange(self, order: SceneOrder) -> Setup:
        """Sets up a scene in place of the one before."""
        rng = episode_generators(order.seed)[0]
        drawn = self._names[int(rng.integers(len(self._names)))]
        name = drawn if order.object_name is None else order.object_name
        state = self._scene.reset(rng, name, order.reference_camera)
        self._seed = order.seed
        return Setup(name, state.T_world_obj[name], state.T_cam_world, float(state.visibility))

    def shoot(self, T_cam_world: np.ndarray, number: int) -> np.ndarray:
        """Takes a picture of the scene: RGB uint8 (H, W, 3)."""
        picture = self._renderer.render(T_cam_world, self._K).rgb
        rng = episode_generators(self._seed)[2 + number]
        return apply_sensor(picture, self._config.randomization.sensor, rng)

    def visibility_from(self, T_cam_world: np.ndarray) -> float:
        """Visible fraction of the target from a camera (4, 4)."""
        state = self._scene.state
        assert state is not None
        return float(self._scene.probe_visibility([state.target], T_cam_world)[0])

    def close(self) -> None:
        """Frees the GL context; the next picture opens another."""
        self._renderer.close()


def episode_generators(scene_seed: int) -> list[np.random.Generator]:
    """One stream for each purpose, so that what one of them draws never moves another.

    Returns:
        For the scene, for the error of the poses that the estimator is told, and for the sensor in
        each of ``MOST_VIEWS`` views.
    """
    return np.random.default_rng(scene_seed).spawn(2 + MOST_VIEWS)


def scaled_intrinsics(resolution: tuple[int, int]) -> np.ndarray:
    """LineMOD's camera matrix for pictures of another size (height, width).

    A picture of other proportions than 3 to 4 shows the middle of LineMOD's, as much of it as there
    is room for.

    Raises:
        ValueError: if there are no pixels.
    """
    height, width = resolution
    if not (height >= 1 and width >= 1):
        raise ValueError(f"resolution must be (height, width) of at least 1, got {resolution}")
    full_height, full_width = LINEMOD_IMAGE_SIZE
    scale = max(height / full_height, width / full_width)
    A = np.diag([scale, scale, 1.0])
    # The middle of the picture stays the middle of LineMOD's.
    A[0, 2] = (width - 1) / 2 - scale * (full_width - 1) / 2
    A[1, 2] = (height - 1) / 2 - scale * (full_height - 1) / 2
    return A @ LINEMOD_K
