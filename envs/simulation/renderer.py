"""Renders RGB, metric depth and instance masks of a scene from any OpenCV camera.

All passes use the same rasterizer, so RGB, depth and masks agree to the pixel.
"""

from dataclasses import dataclass

import numpy as np

from ...core.errors import InputError
from ...core.geometry import LINEMOD_K, check_intrinsics, check_rigid
from .graphics import MAX_SIDE
from .scene import Scene


@dataclass(frozen=True, eq=False)
class Frame:
    """One rendered image.

    Attributes:
        rgb: (H, W, 3) uint8.
        depth: (H, W) float32, z in the camera frame in meters; None unless requested.
        instances: (H, W) int32, index into ``object_names`` or -1; None unless requested.
        object_names: objects in the scene.
    """

    rgb: np.ndarray
    depth: np.ndarray | None
    instances: np.ndarray | None
    object_names: tuple[str, ...]


class SceneRenderer:
    """Renders a scene at one image size.

    Args:
        scene: rendered in its current state.
        height: of the images, pixels.
        width: of the images, pixels.

    Raises:
        InputError: if the size is not between 1 and 4096 pixels.
    """

    def __init__(self, scene: Scene, height: int = 480, width: int = 640) -> None:
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
            K: camera matrix, (3, 3) pixels; ``crop_matrix(...) @ K`` renders a crop directly.
            depth: also render metric depth.
            masks: also render instance masks.

        Raises:
            InputError: if the pose is not rigid or K is not a camera matrix without skew.
            GraphicsUnavailable: if there is no OpenGL to render with.
        """
        T_cam_world = check_rigid(T_cam_world, "T_cam_world")
        K = check_intrinsics(K)
        graphics = self._scene.graphics
        rect = graphics.draw(T_cam_world, K, self.height, self.width, shadows=self._scene.shadows)
        rgb, z = graphics.read(rect, depth=depth)
        names, present = self._scene.present_objects()
        instances = None
        if masks:
            rect = graphics.draw(T_cam_world, K, self.height, self.width, segment=True)
            numbers = np.full(self._scene.world.model.ngeom, -1, dtype=np.int32)
            numbers[present] = np.arange(len(present))
            instances = graphics.geoms(rect, numbers)
        return Frame(rgb, z, instances, names)

    def close(self) -> None:
        """Frees the scene's GL context; the next image opens a new one."""
        self._scene.graphics.close()
