"""A picture of ours with depth and masks beside pyrender's colour, depth and segmentation.

Both sides draw the thirteen objects with the same triangles, textures, poses and camera, in one
process and in turn. Ours also draws the room, the table and shadows; pyrender has one light and no
shadows, and draws the scene twice, the second time for the segmentation. One comparison leaves out
our shadows too; another adds all that a picture of the generator is annotated with, for which ours
draws every silhouette.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..pose_estimator.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K, invert
from ..pose_estimator.stopwatch import Missing, Record, in_own_process, ratio

if TYPE_CHECKING:
    from .scene import Scene

INSTALL_HINT = (
    "pip install 'two-view-pose[bench]', then pip install --no-deps pyrender==0.1.45 (its own list "
    "of dependencies asks for PyOpenGL 3.1.0, with which MuJoCo cannot use EGL)"
)


def compare_with_pyrender(repeats: int, seed: int) -> list[Record | Missing]:
    """Times both in a process of its own: pyrender ends the EGL display that MuJoCo shares with it.

    Args:
        repeats: timed repeats of each side.
        seed: of the scene.
    """
    found = in_own_process(_compare, repeats, seed)
    return [Missing("pyrender", found, INSTALL_HINT)] if isinstance(found, str) else [*found]


def full_scene(seed: int) -> Scene:
    """A scene, reset, in which all thirteen objects stand on the table and nothing else does."""
    from .. import assets
    from .scene import Scene, SceneConfig

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
        A function that gives RGB (H, W, 3) uint8, depth (H, W) float32 in metres, and instances
        (H, W) int32: the index of the object in ``scene.present_objects()``, or -1.
    """
    import pyrender
    from PIL import Image

    from .camera import opencv_to_opengl
    from .world import FAR, NEAR

    assert scene.state is not None
    height, width = LINEMOD_IMAGE_SIZE
    drawn = pyrender.Scene(ambient_light=[0.3, 0.3, 0.3])
    colours = {}
    for index, name in enumerate(scene.present_objects()[0]):
        model = scene.objects[name]
        texture = pyrender.Texture(source=Image.fromarray(model.texture), source_channels="RGB")
        primitive = pyrender.Primitive(
            positions=model.vertices,
            normals=_vertex_normals(model.vertices, model.faces),
            indices=model.faces,
            texcoord_0=model.uv,
            material=pyrender.MetallicRoughnessMaterial(
                baseColorTexture=texture, metallicFactor=0.0, roughnessFactor=0.7
            ),
        )
        node = drawn.add(pyrender.Mesh([primitive]), pose=scene.state.T_world_obj[name])
        colours[node] = (index + 1, 0, 0)
    K = LINEMOD_K
    camera = pyrender.IntrinsicsCamera(  # its pixels' corners are whole numbers, not their centres
        K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, znear=NEAR, zfar=FAR
    )
    T_world_camera = invert(opencv_to_opengl(T_cam_world))
    drawn.add(camera, pose=T_world_camera)
    drawn.add(pyrender.DirectionalLight(intensity=3.0), pose=T_world_camera)
    renderer = pyrender.OffscreenRenderer(width, height)

    def draw() -> tuple[np.ndarray, ...]:
        rgb, depth = renderer.render(drawn)
        segments, _ = renderer.render(drawn, pyrender.RenderFlags.SEG, colours)
        return rgb, depth, segments[..., 0].astype(np.int32) - 1

    return draw


def _vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mean of the normals (V, 3) of the triangles around each vertex."""
    import trimesh

    return np.array(trimesh.Trimesh(vertices, faces, process=False).vertex_normals)


def _compare(repeats: int, seed: int) -> list[Record] | str:
    """In the child: the records, or why there are none."""
    from .annotation import annotate
    from .bench_rendering import agreement
    from .gl import backend
    from .renderer import Frame, SceneRenderer

    scene = full_scene(seed)
    assert scene.state is not None
    T_cam_world = scene.state.T_cam_world
    renderer = SceneRenderer(scene)

    def pictures() -> Frame:
        return renderer.render(T_cam_world, depth=True, masks=True)

    def annotated() -> None:
        annotate(scene, pictures(), T_cam_world, LINEMOD_K)

    instances = pictures().instances
    assert instances is not None
    if backend() not in ("egl", "osmesa"):
        return f"pyrender draws off screen with EGL or OSMesa only, MuJoCo uses {backend()}"
    os.environ["PYOPENGL_PLATFORM"] = str(backend())
    try:
        theirs = pyrender_scene(scene, T_cam_world)
        *_, their_instances = theirs()
    except Exception as error:  # it is old and may trip over anything, which this line then says
        renderer.close()
        return f"{type(error).__name__}: {error}"
    against = "pyrender: colour, depth, segmentation"
    work = "RGB, depth and masks of 13 objects, 640x480"
    records = [
        ratio(work, against, pictures, theirs, repeats, goal=2.0),
        ratio(f"{work}; silhouettes, boxes, visibility", against, annotated, theirs, repeats, 1.0),
    ]
    scene.world.model.light_castshadow[:] = 0
    alike = f"{work}; without shadows, as theirs"
    records.insert(0, ratio(alike, against, pictures, theirs, repeats, goal=2.0))
    renderer.close()  # first: with pyrender's context goes the display
    agreed = agreement(instances, their_instances)
    return [{**record, "agreement_of_masks": agreed} for record in records]
