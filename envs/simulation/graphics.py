"""The OpenGL context of a scene, opened with its first image and shared by its renderers.

MuJoCo's classic renderer without multisampling and with a smaller shadow map, which makes software
OpenGL fast.
"""

import atexit
import os
import weakref
from typing import Any

import cv2
import numpy as np

from ...core.geometry import invert
from .camera import frustum, opencv_to_opengl, view_sphere_pose
from .gl import backend, make_current, mujoco, open_context, release_current
from .world import FAR, NEAR, GeomGroup, World, compile_world

SAMPLES = 0
"""Samples per pixel for multisampling; none is several times faster."""
SHADOW_MAP_SIZE = 512
"""Side of the shadow map, pixels."""
MAX_SIDE = 4096
"""Maximum side of an image, pixels."""
_MAX_GEOMS = 200  # at most 255: segment ids fit a byte

TILE = (480, 640)
"""Height and width in pixels of the tiles in which larger silhouettes are rendered."""


class Graphics:
    """The GL context of one scene, created with the first image, in the process that renders it.

    Args:
        world: the compiled model.
        data: poses of its bodies.
        texture_versions: number of changes of each texture, (ntex,); changed ones are uploaded
            before the next image.
    """

    def __init__(self, world: World, data: mujoco.MjData, texture_versions: np.ndarray) -> None:
        self._world = world
        self._data = data
        self._versions = texture_versions
        self._uploaded = np.zeros_like(self._versions)
        self._gl: Any = None
        self._context: mujoco.MjrContext | None = None
        self._pid = -1
        self._scene: mujoco.MjvScene | None = None
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._perturb = mujoco.MjvPerturb()

    def draw(
        self,
        T_cam_world: np.ndarray,
        K: np.ndarray,
        height: int,
        width: int,
        *,
        segment: bool = False,
        groups: tuple[int, ...] = (GeomGroup.MOVABLE, GeomGroup.ROOM),
        shadows: bool = True,
    ) -> mujoco.MjrRect:
        """Renders into the lower left corner of the buffer; :meth:`read` returns the pixels.

        The groups are drawn in order. Occluded fragments are not shaded, so the room comes last.
        """
        context = self._ready(height, width)
        scene = self._scene
        assert scene is not None
        model, option = self._world.model, self._option
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        for group in groups:
            option.geomgroup[:] = 0
            option.geomgroup[group] = 1
            if group == groups[0]:
                mujoco.mjv_updateScene(
                    model, self._data, option, None, self._camera, everything, scene
                )
            else:
                mujoco.mjv_addGeoms(model, self._data, option, self._perturb, everything, scene)
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
        self, rect: mujoco.MjrRect, depth: bool = False
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Returns the last image: RGB (H, W, 3) uint8 and z-depth (H, W) float32 in meters."""
        shape = (rect.height, rect.width)
        pixels = np.empty((*shape, 3), dtype=np.uint8)
        buffer = np.empty(shape, dtype=np.float32) if depth else None
        make_current(self._gl)
        mujoco.mjr_readPixels(pixels, buffer, rect, self._context)
        release_current()
        if buffer is not None:
            # The buffer holds d = near (far - z) / (z (far - near)), reversed for precision.
            buffer = buffer[::-1] * np.float32((FAR - NEAR) / (FAR * NEAR))
            buffer += np.float32(1 / FAR)
            np.divide(np.float32(1.0), buffer, out=buffer)
        return np.ascontiguousarray(pixels[::-1]), buffer

    def geoms(self, rect: mujoco.MjrRect, numbers: np.ndarray | None = None) -> np.ndarray:
        """Returns the geom at each pixel of an image drawn with ``segment``, (H, W) int32, or -1.

        Args:
            rect: as :meth:`draw` returned it.
            numbers: of the model's geoms, (ngeom,); their ids if None.
        """
        pixels, _ = self.read(rect)
        assert self._scene is not None
        table = np.full(256, -1, dtype=np.int32)  # segment id + 1 is a pixel's first byte
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.segid >= 0 and geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                table[geom.segid + 1] = geom.objid if numbers is None else numbers[geom.objid]
        return cv2.LUT(cv2.extractChannel(pixels, 0), table)

    def silhouette(
        self, geom: int, T_cam_world: np.ndarray, K: np.ndarray, height: int, width: int
    ) -> np.ndarray:
        """Returns the silhouette of ``geom`` without occlusion, (H, W) bool.

        Images larger than ``TILE`` are rendered in tiles: windows may extend far beyond the image,
        and the buffer, which never shrinks, would grow with the largest of them.
        """
        silhouette = np.zeros((height, width), dtype=bool)
        group = self._world.model.geom_group
        before = int(group[geom])
        group[geom] = GeomGroup.ISOLATED
        try:
            for top in range(0, height, TILE[0]):
                for left in range(0, width, TILE[1]):
                    tile = silhouette[top : top + TILE[0], left : left + TILE[1]]
                    tile_K = K - [[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]]
                    rect = self.draw(
                        T_cam_world, tile_K, *tile.shape, segment=True, groups=(GeomGroup.ISOLATED,)
                    )
                    tile[:] = self.read(rect)[0][..., 0] > 0
        finally:
            group[geom] = before
        return silhouette

    @property
    def buffer_size(self) -> tuple[int, int]:
        """Height and width of the offscreen buffer in pixels, zeros before the first image."""
        context = self._context
        return (0, 0) if context is None else (context.offHeight, context.offWidth)

    def __reduce__(self) -> tuple[Any, ...]:
        return Graphics, (self._world, self._data, self._versions)  # a copy opens its own context

    def close(self) -> None:
        """Frees the context; the next image opens a new one."""
        if self._context is not None and self._pid == os.getpid():
            make_current(self._gl)
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
            self._gl = open_context(MAX_SIDE, MAX_SIDE)
            make_current(self._gl)
            quality = model.vis.quality
            default = quality.offsamples, quality.shadowsize
            quality.offsamples, quality.shadowsize = SAMPLES, SHADOW_MAP_SIZE
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
                # Registered after EGL's own handler, hence run before it.
                atexit.unregister(_close_all)
                atexit.register(_close_all)
            _open_graphics.add(self)
        else:
            make_current(self._gl)
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


_open_graphics: weakref.WeakSet[Graphics] = weakref.WeakSet()


def _close_all() -> None:
    for graphics in list(_open_graphics):
        graphics.close()


def aim(
    scene: mujoco.MjvScene, T_cam_world: np.ndarray, K: np.ndarray, height: int, width: int
) -> None:
    """Sets the cameras of MuJoCo's scene to an OpenCV camera T_cam_world (4, 4), K (3, 3)."""
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


def check_rendering() -> None:
    """Renders a small image of a table and prints the name of the OpenGL back-end.

    Raises:
        GraphicsUnavailable: if there is no OpenGL to render with.
        RuntimeError: if the image is empty.
    """
    world = compile_world({})
    graphics = Graphics(world, mujoco.MjData(world.model), np.zeros(world.model.ntex))
    mujoco.mj_forward(world.model, graphics._data)
    K = np.array([[32.0, 0.0, 15.5], [0.0, 32.0, 15.5], [0.0, 0.0, 1.0]])
    image, _ = graphics.read(graphics.draw(view_sphere_pose(np.zeros(3), 2.0, 0.5, 0.5), K, 32, 32))
    if image.std() < 1:
        raise RuntimeError(f"{backend()} renders an empty image")
    print(backend())
