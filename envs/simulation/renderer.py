"""Images of a scene: RGB, metric depth and instance masks, from any OpenCV camera.

The pixels are found by the same rasterizer in every pass, so RGB, depth and masks agree to the
pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...core.errors import InputError
from ...core.geometry import LINEMOD_K, check_intrinsics, check_rigid
from .graphics import MAX_SIDE, Graphics
from .world import World


@dataclass(frozen=True, eq=False)
class Frame:
    """One rendered image and what is known of each of its pixels.

    Attributes:
        rgb: (H, W, 3) uint8.
        depth: (H, W) float32, z in the camera frame in meters; None unless asked for.
        instances: (H, W) int32, index into ``object_names`` or -1 where there is none of them;
            None unless asked for.
        object_names: the objects that stand in the scene.
    """

    rgb: np.ndarray
    depth: np.ndarray | None
    instances: np.ndarray | None
    object_names: tuple[str, ...]


class RenderableScene(Protocol):
    """What a renderer asks of a scene."""

    world: World
    graphics: Graphics

    @property
    def shadows(self) -> bool:
        """Whether there are shadows."""
        ...

    def present_objects(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Names of the objects that are seen, and their geoms."""
        ...


class SceneRenderer:
    """Renders a scene at one image size.

    Args:
        scene: what is drawn, in the state of its last reset.
        height: of the images, pixels.
        width: of the images, pixels.

    Raises:
        InputError: if the size is not between 1 and 4096 pixels.
    """

    def __init__(self, scene: RenderableScene, height: int = 480, width: int = 640) -> None:
        for name, side in (("height", height), ("width", width)):
            if not (isinstance(side, int | np.integer) and 1 <= side <= MAX_SIDE):
                raise InputError(f"{name} must be 1 to {MAX_SIDE} whole pixels, got {side!r}")
        self._scene = scene
        self.height = int(height)
        self.width = int(width)

    def render(
        self,
        T_cam_world: np.ndarray,
        K: np.ndarray = LINEMOD_K,
        *,
        depth: bool = False,
        masks: bool = False,
    ) -> Frame:
        """Renders one image.

        Args:
            T_cam_world: world to OpenCV camera, (4, 4).
            K: camera matrix in pixels of this image, (3, 3); ``crop_matrix(...) @ K`` renders a
                crop directly.
            depth: also return metric depth.
            masks: also return instance masks.

        Raises:
            InputError: if the pose is not rigid or K is not a camera matrix without skew.
            GraphicsUnavailable: if there is no OpenGL to draw with.
        """
        T_cam_world = check_rigid(T_cam_world, "T_cam_world")
        K = check_intrinsics(K)
        graphics = self._scene.graphics
        rect = graphics.draw(T_cam_world, K, self.height, self.width, shadows=self._scene.shadows)
        rgb, z = graphics.read(rect, depth=depth)
        assert rgb is not None
        names, present = self._scene.present_objects()
        instances = None
        if masks:
            rect = graphics.draw(T_cam_world, K, self.height, self.width, segment=True)
            numbers = np.full(self._scene.world.model.ngeom, -1, dtype=np.int32)
            numbers[present] = np.arange(len(present))
            instances = graphics.geoms(rect, numbers)
        return Frame(rgb, z, instances, names)

    def close(self) -> None:
        """Frees the scene's GL context; whoever renders next opens another."""
        self._scene.graphics.close()

    def __enter__(self) -> SceneRenderer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
