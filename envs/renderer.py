"""Pictures of a scene: RGB, metric depth, instance masks and visibility, from any OpenCV camera.

The pixels are found by the same rasteriser in every pass, so RGB, depth and masks agree to the
pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..pose_estimator.geometry import (
    LINEMOD_K,
    check_intrinsics,
    check_rigid,
    project,
    transform,
)
from .graphics import LARGEST_SIDE
from .world import NEAR

if TYPE_CHECKING:
    from .scene import Scene


@dataclass(frozen=True, eq=False)
class Frame:
    """One rendered picture and what is known of each of its pixels.

    Attributes:
        rgb: (H, W, 3) uint8.
        depth: (H, W) float32, z in the camera frame in metres; None unless asked for.
        instances: (H, W) int32, index into ``object_names`` or -1 where there is none of them;
            None unless asked for.
        object_names: the objects that stand in the scene.
        visibility: for each object, its visible pixels over the pixels of its silhouette with
            nothing before it, both inside the picture (0 where it lies wholly outside); None
            unless asked for.
    """

    rgb: np.ndarray
    depth: np.ndarray | None
    instances: np.ndarray | None
    object_names: tuple[str, ...]
    visibility: dict[str, float] | None


def bounding_box(
    points: np.ndarray, K: np.ndarray, height: int, width: int
) -> tuple[int, int, int, int]:
    """The part of a picture that a thing may cover: left, top and, exclusive, right, bottom.

    Args:
        points: its vertices in the camera frame, (N, 3) metres.
        K: camera matrix, (3, 3).
        height: of the picture, pixels.
        width: of the picture, pixels.
    """
    if points[:, 2].max() <= NEAR:
        return 0, 0, 0, 0
    if points[:, 2].min() <= NEAR:  # it reaches behind the camera
        return 0, 0, width, height
    uv = project(points, K)
    left, top = np.clip(np.floor(uv.min(axis=0)) - 1, 0, (width, height)).astype(int).tolist()
    right, bottom = np.clip(np.ceil(uv.max(axis=0)) + 2, 0, (width, height)).astype(int).tolist()
    return left, top, right, bottom


class SceneRenderer:
    """Renders a scene at one picture size.

    Args:
        scene: what is drawn, in the state of its last reset.
        height: of the pictures, pixels.
        width: of the pictures, pixels.

    Raises:
        ValueError: if the size is not between 1 and 4096 pixels.
    """

    def __init__(self, scene: Scene, height: int = 480, width: int = 640) -> None:
        for name, side in (("height", height), ("width", width)):
            if not (isinstance(side, int | np.integer) and 1 <= side <= LARGEST_SIDE):
                raise ValueError(f"{name} must be 1 to {LARGEST_SIDE} whole pixels, got {side!r}")
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
        visibility: bool = False,
    ) -> Frame:
        """Renders one picture.

        Args:
            T_cam_world: world to OpenCV camera, (4, 4).
            K: camera matrix in pixels of this picture, (3, 3); ``crop_matrix(...) @ K`` renders a
                crop directly.
            depth: also return metric depth.
            masks: also return instance masks.
            visibility: also return each object's visible fraction.

        Raises:
            ValueError: if the pose is not rigid or K is not a camera matrix without skew.
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
        fractions = None
        if masks or visibility:
            rect = graphics.draw(T_cam_world, K, self.height, self.width, segment=True)
            numbers = np.full(self._scene.world.model.ngeom, -1, dtype=np.int32)
            numbers[present] = np.arange(len(present))
            instances = graphics.geoms(rect, numbers)
        if visibility:
            assert instances is not None
            fractions = self._fractions(T_cam_world, K, names, present, instances)
        return Frame(rgb, z, instances if masks else None, names, fractions)

    def _fractions(
        self,
        T_cam_world: np.ndarray,
        K: np.ndarray,
        names: tuple[str, ...],
        geoms: np.ndarray,
        instances: np.ndarray,
    ) -> dict[str, float]:
        """Each silhouette is drawn alone, on the same pixels, but only where it can be."""
        assert self._scene.state is not None
        seen = np.bincount(instances.ravel() + 1, minlength=len(geoms) + 1)[1:]
        fractions = {}
        for name, geom, pixels in zip(names, geoms, seen.tolist(), strict=True):
            T_cam_obj = T_cam_world @ self._scene.state.T_world_obj[name]
            points = transform(T_cam_obj, self._scene.objects[name].vertices)
            left, top, right, bottom = bounding_box(points, K, self.height, self.width)
            if right <= left or bottom <= top:
                fractions[name] = 0.0
                continue
            corner = np.array([[1.0, 0.0, -left], [0.0, 1.0, -top], [0.0, 0.0, 1.0]])
            alone = self._scene.graphics.silhouette(
                geom, T_cam_world, corner @ K, bottom - top, right - left
            )
            fractions[name] = min(1.0, pixels / max(1, np.count_nonzero(alone)))
        return fractions

    def close(self) -> None:
        """Frees the scene's GL context; whoever renders next opens another."""
        self._scene.graphics.close()

    def __enter__(self) -> SceneRenderer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
