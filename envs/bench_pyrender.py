"""A fully annotated picture of ours beside pyrender's colour, depth and segmentation of one scene.

Both sides draw the thirteen objects with the same triangles, textures, poses and camera, in one
process and in turn. Ours also draws the room, the table and shadows, and every silhouette; pyrender
has one light and no shadows, and draws the scene twice, the second time for the segmentation.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from ..pose_estimator.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K, invert

if TYPE_CHECKING:
    from .scene import Scene

INSTALL_HINT = (
    "pip install 'two-view-pose[bench]', then pip install --no-deps pyrender==0.1.45 (its own list "
    "of dependencies asks for PyOpenGL 3.1.0, with which MuJoCo cannot use EGL)"
)


class PyrenderUnavailable(ImportError):
    """pyrender is not there, or does not work; the message says why."""


def compare_with_pyrender(repeats: int, seed: int) -> dict[str, Any]:
    """Times both in a process of its own: pyrender ends the EGL display that MuJoCo shares with it.

    Args:
        repeats: timed repeats of each side.
        seed: of the scene.

    Returns:
        A record of the results file.

    Raises:
        PyrenderUnavailable: if pyrender or something that it needs is missing.
    """
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, spawn) as process:
        found = process.submit(_compare, repeats, seed).result()
    if isinstance(found, str):
        raise PyrenderUnavailable(found)
    return found


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


def _compare(repeats: int, seed: int) -> dict[str, Any] | str:
    """In the child: the record, or why there is none."""
    from .annotation import annotate
    from .bench import ratio
    from .gl import backend
    from .renderer import SceneRenderer

    scene = full_scene(seed)
    assert scene.state is not None
    T_cam_world = scene.state.T_cam_world
    renderer = SceneRenderer(scene)

    def ours() -> np.ndarray:
        frame = renderer.render(T_cam_world, depth=True, masks=True)
        annotate(scene, frame, T_cam_world, LINEMOD_K)
        assert frame.instances is not None
        return frame.instances

    instances = ours()
    if backend() not in ("egl", "osmesa"):
        return f"pyrender draws off screen with EGL or OSMesa only, MuJoCo uses {backend()}"
    os.environ["PYOPENGL_PLATFORM"] = str(backend())
    try:
        theirs = pyrender_scene(scene, T_cam_world)
        *_, their_instances = theirs()
    except Exception as error:  # it is old and may trip over anything, which this line then says
        renderer.close()
        return f"{type(error).__name__}: {error}"
    record = ratio(
        "RGB, depth, masks, silhouettes, boxes, visibility; 13 objects, 640x480",
        "pyrender: colour, depth, segmentation",
        ours,
        theirs,
        repeats,
        goal=1.0,
    )
    renderer.close()  # first: with pyrender's context goes the display
    both = (instances >= 0) | (their_instances >= 0)
    agreement = np.count_nonzero((instances == their_instances) & both) / np.count_nonzero(both)
    return {**record, "agreement_of_masks": float(agreement)}
