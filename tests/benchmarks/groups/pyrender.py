"""Our image with depth and masks, compared with pyrender's color, depth and segmentation.

Both sides draw the thirteen objects with the same triangles, textures, poses and camera, in one
process and in turn. Ours also draws the room, the table and shadows; pyrender has one light and no
shadows, and draws the scene twice, the second time for the segmentation. One comparison leaves out
our shadows too; another adds all that an image of the generator is annotated with, for which ours
draws every silhouette.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator

import numpy as np
import trimesh
from PIL import Image
from two_view_pose import assets
from two_view_pose.core.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K, invert
from two_view_pose.envs.simulation.annotation import annotate
from two_view_pose.envs.simulation.camera import opencv_to_opengl
from two_view_pose.envs.simulation.gl import backend
from two_view_pose.envs.simulation.renderer import Frame, SceneRenderer
from two_view_pose.envs.simulation.scene import Scene, SceneConfig
from two_view_pose.envs.simulation.world import FAR, NEAR

from ..config import BenchConfig
from ..own_process import each_from_own_process
from ..stopwatch import Record, missing, ratio
from .rendering import agreement

INSTALL_HINT = (
    "pip install 'two-view-pose[bench]', then pip install --no-deps pyrender==0.1.45 (its own list "
    "of dependencies asks for PyOpenGL 3.1.0, with which MuJoCo cannot use EGL)"
)


def measure(config: BenchConfig) -> Iterator[Record]:
    """Times both in a fresh process: pyrender ends the EGL display that MuJoCo shares with it."""
    yield from each_from_own_process(compare, config)


def full_scene(seed: int) -> Scene:
    """A scene, reset, in which all thirteen objects stand on the table and nothing else does."""
    objects = assets.load_objects(None)
    others = len(objects) - 1
    config = SceneConfig(clutter_objects=(others, others), plain_shapes=(0, 0))
    scene = Scene(objects, config)
    rng = np.random.default_rng(seed)
    for _ in range(50):  # clutter for which there is no room is left out
        state = scene.reset(rng, scene.object_names[0])
        if len(state.T_world_obj) == len(objects):
            return scene
    raise RuntimeError("no arrangement holds all objects")


def pyrender_scene(scene: Scene, T_cam_world: np.ndarray) -> Callable[[], tuple[np.ndarray, ...]]:
    """What draws the scene's objects with pyrender.

    Args:
        scene: after a reset, and after MuJoCo drew it: PyOpenGL is bound to one platform then.
        T_cam_world: world to OpenCV camera, (4, 4).

    Returns:
        A function that gives RGB (H, W, 3) uint8, depth (H, W) float32 in meters, and instances
        (H, W) int32: the index of the object in ``scene.present_objects()``, or -1.
    """
    import pyrender

    assert scene.state is not None
    height, width = LINEMOD_IMAGE_SIZE
    drawn = pyrender.Scene(ambient_light=[0.3, 0.3, 0.3])
    colors = {}
    for index, name in enumerate(scene.present_objects()[0]):
        model = scene.objects[name]
        mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
        texture = pyrender.Texture(source=Image.fromarray(model.texture), source_channels="RGB")
        primitive = pyrender.Primitive(
            positions=model.vertices,
            normals=np.array(mesh.vertex_normals),
            indices=model.faces,
            texcoord_0=model.uv,
            material=pyrender.MetallicRoughnessMaterial(
                baseColorTexture=texture, metallicFactor=0.0, roughnessFactor=0.7
            ),
        )
        node = drawn.add(pyrender.Mesh([primitive]), pose=scene.state.T_world_obj[name])
        colors[node] = (index + 1, 0, 0)
    K = LINEMOD_K
    camera = pyrender.IntrinsicsCamera(  # its pixels' corners are whole numbers, not their centers
        K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, znear=NEAR, zfar=FAR
    )
    T_world_camera = invert(opencv_to_opengl(T_cam_world))
    drawn.add(camera, pose=T_world_camera)
    drawn.add(pyrender.DirectionalLight(intensity=3.0), pose=T_world_camera)
    renderer = pyrender.OffscreenRenderer(width, height)

    def draw() -> tuple[np.ndarray, ...]:
        rgb, depth = renderer.render(drawn)
        segments, _ = renderer.render(drawn, pyrender.RenderFlags.SEG, colors)
        return rgb, depth, segments[..., 0].astype(np.int32) - 1

    return draw


def compare(config: BenchConfig) -> Iterator[Record]:
    """In the child: the records, or why there are none."""
    scene = full_scene(config.seed)
    assert scene.state is not None
    T_cam_world = scene.state.T_cam_world
    renderer = SceneRenderer(scene)

    def images() -> Frame:
        return renderer.render(T_cam_world, depth=True, masks=True)

    def annotated() -> None:
        annotate(scene, images(), T_cam_world, LINEMOD_K)

    instances = images().instances
    assert instances is not None
    if backend() not in ("egl", "osmesa"):
        reason = f"pyrender draws off screen with EGL or OSMesa only, MuJoCo uses {backend()}"
        yield missing("pyrender", reason, INSTALL_HINT)
        return
    os.environ["PYOPENGL_PLATFORM"] = str(backend())
    try:
        theirs = pyrender_scene(scene, T_cam_world)
        *_, their_instances = theirs()
    except Exception as error:  # it is old and may trip over anything, which this line then says
        renderer.close()
        yield missing("pyrender", f"{type(error).__name__}: {error}", INSTALL_HINT)
        return
    against = "pyrender: color, depth, segmentation"
    work = "RGB, depth and masks of 13 objects, 640x480"
    agreed = {"agreement_of_masks": agreement(instances, their_instances)}
    casts_shadow = scene.world.model.light_castshadow.copy()
    for said, ours, shadows, goal in (
        ("; without shadows, as theirs", images, False, 2.0),
        ("", images, True, 2.0),
        ("; silhouettes, boxes, visibility", annotated, True, 1.0),
    ):
        scene.world.model.light_castshadow[:] = casts_shadow * shadows
        yield {**ratio(f"{work}{said}", against, ours, theirs, config.repeats, goal), **agreed}
    renderer.close()  # first: with pyrender's context goes the display
