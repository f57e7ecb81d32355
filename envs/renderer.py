"""Pictures of a scene: RGB, metric depth, instance masks and visibility, from any OpenCV camera.

Built on MuJoCo's classic renderer without multisampling and with a smaller shadow map, which is
what makes software OpenGL quick. The pixels are found by the same rasteriser in every pass, so
RGB, depth and masks agree to the pixel.
"""

from __future__ import annotations

import atexit
import os
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..pose_estimator.geometry import (
    LINEMOD_K,
    check_intrinsics,
    check_rigid,
    invert,
    project,
    transform,
)
from .camera import frustum, opencv_to_opengl
from .gl import mujoco, open_context
from .world import FAR, MOVABLE, NEAR, PROBED, ROOM

if TYPE_CHECKING:
    from .scene import Scene

SHADOW_MAP_SIZE = 512
LARGEST_SIDE = 4096
_MAX_GEOMS = 200


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


class Graphics:
    """The GL context of one scene: made at the first picture, in the process that draws it.

    All renderers of a scene share it, so meshes and textures lie in memory once.

    Args:
        scene: what is drawn.
        samples: of multisampling; none is several times faster.
        shadow_map: side of the shadow map in pixels.
    """

    def __init__(self, scene: Scene, samples: int = 0, shadow_map: int = SHADOW_MAP_SIZE) -> None:
        self._quality = (samples, shadow_map)
        self._world = scene.world
        self._data = scene.data
        self._versions = scene.texture_versions
        self._uploaded = np.zeros_like(self._versions)
        self._gl: Any = None
        self._context: mujoco.MjrContext | None = None
        self._pid = -1
        self._scene: mujoco.MjvScene | None = None
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()

    def draw(
        self,
        T_cam_world: np.ndarray,
        K: np.ndarray,
        height: int,
        width: int,
        *,
        segment: bool = False,
        groups: tuple[int, ...] = (ROOM, MOVABLE),
        shadows: bool = True,
    ) -> mujoco.MjrRect:
        """Draws into the lower left corner of the buffer; :meth:`read` gets the pixels."""
        context = self._ready(height, width)
        scene = self._scene
        assert scene is not None
        self._option.geomgroup[:] = 0
        self._option.geomgroup[list(groups)] = 1
        mujoco.mjv_updateScene(
            self._world.model,
            self._data,
            self._option,
            None,
            self._camera,
            mujoco.mjtCatBit.mjCAT_ALL.value,
            scene,
        )
        aim(scene, T_cam_world, K, height, width)
        scene.flags[:] = 0
        scene.flags[mujoco.mjtRndFlag.mjRND_CULL_FACE] = 1
        if segment:
            scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = 1
            scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
        elif shadows:
            scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 1
        rect = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rect, scene, context)
        return rect

    def read(
        self, rect: mujoco.MjrRect, rgb: bool = True, depth: bool = False
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The picture just drawn: RGB (H, W, 3) uint8 and z-depth (H, W) float32 in metres."""
        shape = (rect.height, rect.width)
        pixels = np.empty((*shape, 3), dtype=np.uint8) if rgb else None
        buffer = np.empty(shape, dtype=np.float32) if depth else None
        mujoco.mjr_readPixels(pixels, buffer, rect, self._context)
        if pixels is not None:
            pixels = np.ascontiguousarray(pixels[::-1])
        if buffer is not None:
            # The buffer holds d = near (far - z) / (z (far - near)), reversed for precision.
            reciprocal = buffer[::-1] * np.float32((FAR - NEAR) / (FAR * NEAR)) + np.float32(
                1 / FAR
            )
            buffer = np.float32(1.0) / reciprocal
        return pixels, buffer

    def geoms(self, rect: mujoco.MjrRect) -> np.ndarray:
        """The geom at each pixel of a picture drawn with ``segment``, (H, W) int32, else -1."""
        pixels, _ = self.read(rect)
        assert pixels is not None and self._scene is not None
        table = np.full(self._scene.ngeom + 1, -1, dtype=np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.segid >= 0 and geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                table[geom.segid + 1] = geom.objid
        segments = pixels[..., 0].astype(np.int32)
        if self._scene.ngeom >= 256:
            segments += pixels[..., 1].astype(np.int32) << 8
        return table[segments]

    def silhouette(
        self, geom: int, T_cam_world: np.ndarray, K: np.ndarray, height: int, width: int
    ) -> np.ndarray:
        """Where ``geom`` would be seen with nothing before it, (H, W) bool."""
        group = self._world.model.geom_group
        before = int(group[geom])
        group[geom] = PROBED
        try:
            rect = self.draw(T_cam_world, K, height, width, segment=True, groups=(PROBED,))
        finally:
            group[geom] = before
        pixels, _ = self.read(rect)
        assert pixels is not None
        return pixels[..., 0] > 0

    def close(self) -> None:
        """Frees the context; the next picture opens another."""
        if self._context is not None and self._pid == os.getpid():
            self._gl.make_current()
            self._context.free()
            self._gl.free()
        self._gl = self._context = self._scene = None

    def __del__(self) -> None:
        self.close()

    def _ready(self, height: int, width: int) -> mujoco.MjrContext:
        model = self._world.model
        if self._context is not None and self._pid != os.getpid():
            # A forked child: the context belongs to the parent and must not be touched.
            self._keep = (self._gl, self._context)
            self._gl = self._context = None
        if self._context is None:
            self._gl = open_context(LARGEST_SIDE, LARGEST_SIDE)
            self._gl.make_current()
            quality = model.vis.quality
            default = quality.offsamples, quality.shadowsize
            quality.offsamples, quality.shadowsize = self._quality
            try:
                self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50.value)
            finally:
                quality.offsamples, quality.shadowsize = default
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
            self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
            self._scene = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
            self._uploaded[:] = self._versions
            self._pid = os.getpid()
            if not _open_graphics:
                # After EGL's own handler, hence run before it: freed while the library lives.
                atexit.unregister(_close_all)
                atexit.register(_close_all)
            _open_graphics.add(self)
        else:
            self._gl.make_current()
        if width > self._context.offWidth or height > self._context.offHeight:
            mujoco.mjr_resizeOffscreen(
                max(width, self._context.offWidth),
                max(height, self._context.offHeight),
                self._context,
            )
        stale = np.flatnonzero(self._uploaded != self._versions)
        for texture in stale:
            mujoco.mjr_uploadTexture(model, self._context, int(texture))
        self._uploaded[:] = self._versions
        self._context.mat_texrepeat[: 2 * model.nmat] = model.mat_texrepeat.reshape(-1)
        return self._context


def aim(
    scene: mujoco.MjvScene, T_cam_world: np.ndarray, K: np.ndarray, height: int, width: int
) -> None:
    """Points MuJoCo's cameras of an updated scene where an OpenCV camera looks.

    Args:
        scene: its cameras are changed.
        T_cam_world: world to OpenCV camera, (4, 4).
        K: camera matrix in pixels, (3, 3).
        height: of the picture, pixels.
        width: of the picture, pixels.
    """
    T_world_camera = invert(opencv_to_opengl(T_cam_world))
    left, right, bottom, top = frustum(K, height, width, NEAR)
    for camera in scene.camera:
        camera.pos = T_world_camera[:3, 3]
        camera.forward = -T_world_camera[:3, 2]
        camera.up = T_world_camera[:3, 1]
        camera.frustum_center = (left + right) / 2
        camera.frustum_width = (right - left) / 2
        camera.frustum_bottom, camera.frustum_top = bottom, top
        camera.frustum_near, camera.frustum_far = NEAR, FAR


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


_open_graphics: weakref.WeakSet[Graphics] = weakref.WeakSet()


def _close_all() -> None:
    for graphics in list(_open_graphics):
        graphics.close()


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
            index = np.full(self._scene.world.model.ngeom + 1, -1, dtype=np.int32)
            index[present] = np.arange(len(present))
            instances = index[graphics.geoms(rect)]
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
