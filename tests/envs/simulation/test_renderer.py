"""Images against OpenCV's projection, ray casts and closed forms."""

from __future__ import annotations

import dataclasses
import gc
from collections.abc import Iterator
from contextlib import closing

import cv2
import numpy as np
import pytest
import trimesh
from helpers.primitives import primitive_model
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.geometry import LINEMOD_K, crop_matrix, invert
from two_view_pose.envs.simulation import graphics
from two_view_pose.envs.simulation.arrangement import Arrangement, Prop
from two_view_pose.envs.simulation.camera import look_at, view_sphere_pose
from two_view_pose.envs.simulation.placement import PlacedObject
from two_view_pose.envs.simulation.randomization import Randomization
from two_view_pose.envs.simulation.renderer import SceneRenderer
from two_view_pose.envs.simulation.scene import Scene, SceneConfig, SceneState
from two_view_pose.envs.simulation.world import TABLE_HALF

ALONE = SceneConfig(clutter_objects=(0, 0), plain_shapes=(0, 0))


@pytest.fixture(scope="module")
def scene(objects: dict[str, ObjectModel]) -> Iterator[Scene]:
    """Primitives and a small marker ball, in one neutral look."""
    marker = primitive_model("marker", trimesh.creation.icosphere(3, 0.008), 9)
    scene = Scene({**objects, "marker": marker}, ALONE, Randomization.none())
    yield scene
    scene.graphics.close()


def place_objects(scene: Scene, **places: tuple[float, float, float]) -> dict[str, np.ndarray]:
    """Stands objects upright at (x, y, yaw) and shows them; their poses."""
    props = {
        name: Prop(PlacedObject(scene.stable_poses[name][0], np.array([x, y]), yaw))
        for name, (x, y, yaw) in places.items()
    }
    scene.show(Arrangement(props, {}))
    poses = {name: prop.placed.T_world_obj for name, prop in props.items()}
    scene.state = SceneState(next(iter(places)), poses, np.eye(4), 1.0)
    return poses


def cv_project(points: np.ndarray, T_cam_world: np.ndarray, K: np.ndarray) -> np.ndarray:
    """OpenCV's projection of world points (N, 3)."""
    rotation, _ = cv2.Rodrigues(T_cam_world[:3, :3])
    return cv2.projectPoints(points, rotation, T_cam_world[:3, 3], K.copy(), None)[0][:, 0]


@pytest.mark.parametrize("size", [(480, 640), (200, 360), (128, 128)])
def test_a_small_ball_is_drawn_where_opencv_projects_it(
    scene: Scene, size: tuple[int, int]
) -> None:
    height, width = size
    off_center = np.array([[700.0, 0, 0.31 * width], [0, 640.0, 0.66 * height], [0, 0, 1]])
    T_world_obj = place_objects(scene, marker=(0.03, -0.02, 0.5))["marker"]
    rng = np.random.default_rng(0)
    errors = []
    with closing(SceneRenderer(scene, height, width)) as renderer:
        for K in (off_center, LINEMOD_K if height == 480 else off_center):
            for _ in range(12):
                T = view_sphere_pose(
                    T_world_obj[:3, 3], 0.5, rng.uniform(-3, 3), rng.uniform(0.4, 1.2)
                )
                T[:2, 3] += rng.uniform(-0.01, 0.01, 2)
                seen = renderer.render(T, K, masks=True).instances == 0
                assert seen.sum() > 200
                v, u = np.nonzero(seen)
                errors.append(cv_project(T_world_obj[None, :3, 3], T, K)[0] - (u.mean(), v.mean()))
    # Single masks are ragged; half a pixel of misunderstanding would stand out in the mean.
    assert np.abs(np.mean(errors, axis=0)).max() < 0.03
    assert np.abs(errors).max() < 0.25


def test_a_rendered_crop_equals_the_crop_of_the_full_image(scene: Scene) -> None:
    place_objects(scene, brick=(0.0, 0.0, 0.3), post=(0.1, 0.1, 0.0))
    T = view_sphere_pose(np.zeros(3), 0.8, 0.2, 0.6)
    full = SceneRenderer(scene).render(T, depth=True, masks=True)
    left, top, side = 260, 170, 128
    A = crop_matrix(np.array([left + (side - 1) / 2, top + (side - 1) / 2]), side, side)
    crop = SceneRenderer(scene, side, side).render(T, A @ LINEMOD_K, depth=True, masks=True)
    window = np.s_[top : top + side, left : left + side]
    assert np.mean(crop.instances != full.instances[window]) < 1e-3
    np.testing.assert_allclose(crop.depth, full.depth[window], atol=2e-5, rtol=1e-4)
    assert np.abs(crop.rgb.astype(int) - full.rgb[window]).mean() < 0.5


def test_depth_agrees_with_a_ray_cast(scene: Scene) -> None:
    poses = place_objects(
        scene, brick=(0.02, 0.0, 0.3), cone=(-0.1, 0.05, 0.0), ring=(0.05, 0.15, 0.0)
    )
    T = view_sphere_pose(np.array([0, 0, 0.03]), 0.9, 0.7, 0.55)
    frame = SceneRenderer(scene, 480, 640).render(T, depth=True, masks=True)
    meshes = [
        trimesh.Trimesh(scene.objects[n].vertices, scene.objects[n].faces).apply_transform(poses[n])
        for n in poses
    ]
    board = trimesh.creation.box(2 * np.array(TABLE_HALF))
    meshes.append(board.apply_translation((0, 0, -TABLE_HALF[2])))
    rng = np.random.default_rng(1)
    v, u = rng.integers(60, 420, 400), rng.integers(60, 580, 400)
    in_camera = np.column_stack([u, v, np.ones(400)]) @ np.linalg.inv(LINEMOD_K).T
    T_world_cam = invert(T)
    directions = in_camera @ T_world_cam[:3, :3].T  # z in the camera is 1: t is the depth
    depth, which = ray_cast(T_world_cam[:3, 3], directions, meshes)
    surface = np.where(which == 3, -1, which)
    same = frame.instances[v, u] == surface
    assert same.mean() > 0.98  # all but pixels on outlines
    assert set(surface) == {-1, 0, 1, 2}
    assert frame.depth.dtype == np.float32
    hit = same & np.isfinite(depth)  # the room beyond the table is not cast
    assert hit.mean() > 0.8
    np.testing.assert_allclose(frame.depth[v, u][hit], depth[hit], atol=2e-4)


def ray_cast(
    origin: np.ndarray, directions: np.ndarray, meshes: list[trimesh.Trimesh]
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest hit of rays with meshes (Moeller and Trumbore, 1997): distances and mesh indices."""
    best, which = np.full(len(directions), np.inf), np.full(len(directions), -1)
    for index, mesh in enumerate(meshes):
        a, b, c = np.moveaxis(mesh.triangles, 1, 0)
        e1, e2, s = b - a, c - a, origin - a
        h = np.cross(directions[:, None], e2[None])
        det = np.einsum("fj,rfj->rf", e1, h)
        with np.errstate(divide="ignore", invalid="ignore"):
            x = np.einsum("fj,rfj->rf", s, h) / det
            q = np.cross(s, e1)
            y = directions @ q.T / det
            t = np.einsum("fj,fj->f", e2, q)[None] / det
        t = np.where(
            (np.abs(det) > 1e-15) & (x >= 0) & (y >= 0) & (x + y <= 1) & (t > 0), t, np.inf
        )
        nearest = t.min(axis=1)
        which[nearest < best] = index
        best = np.minimum(best, nearest)
    return best, which


def test_instances_are_numbered_as_they_are_named(scene: Scene) -> None:
    poses = place_objects(
        scene, ball=(0.0, 0.0, 0.0), slab=(0.0, 0.25, 0.0), post=(0.0, -0.25, 0.0)
    )
    T = view_sphere_pose(np.zeros(3), 1.2, 0.0, 0.9)
    frame = SceneRenderer(scene).render(T, masks=True)
    assert frame.object_names == ("ball", "slab", "post")
    for index, name in enumerate(frame.object_names):
        u, v = cv_project(poses[name][None, :3, 3], T, LINEMOD_K)[0].round().astype(int)
        assert frame.instances[v, u] == index
    assert set(np.unique(frame.instances)) == {-1, 0, 1, 2}
    assert frame.depth is None


def test_visibility_of_a_half_hidden_box_is_what_geometry_says(scene: Scene) -> None:
    # The camera looks level along +y at the slab's long side; a brick covers part of it.
    slab, brick = scene.objects["slab"].extents, scene.objects["brick"].extents
    x_brick, y_brick, y_slab, eye = 0.045, -0.1, 0.1, np.array([0.0, -0.9, slab[2] / 2])
    place_objects(scene, slab=(0.0, y_slab, 0.0), brick=(x_brick, y_brick, 0.0))
    T = look_at(eye, np.array([0.0, 0.0, slab[2] / 2]))
    z_slab = y_slab - slab[1] / 2 - eye[1]
    half = slab[0] / 2 / z_slab
    # The brick's left side is right of the axis unless its far or near edge reaches beyond.
    left = x_brick - brick[0] / 2
    edge = left / (y_brick + np.copysign(brick[1] / 2, left) - eye[1])
    right = (x_brick + brick[0] / 2) / (y_brick - brick[1] / 2 - eye[1])
    hidden = (min(right, half) - max(edge, -half)) / (2 * half)
    visibility = scene.visibility(["slab", "brick"], T, LINEMOD_K, 480, 640)
    assert 0.3 < hidden < 0.7
    assert visibility[0] == pytest.approx(1 - hidden, abs=0.02)
    assert visibility[1] == 1.0


def test_objects_outside_of_the_image_have_no_visibility(scene: Scene) -> None:
    poses = place_objects(scene, ball=(0.0, 0.0, 0.0), post=(0.5, 0.0, 0.0))
    T = look_at(np.array([0.0, -0.5, 0.4]), poses["ball"][:3, 3])
    K = np.array([[600.0, 0, 99.5], [0, 600.0, 99.5], [0, 0, 1]])
    assert scene.visibility(["ball", "post"], T, K, 200, 200).tolist() == [1.0, 0.0]


def test_textures_are_the_right_way_round() -> None:
    plate = trimesh.creation.box((0.2, 0.2, 0.02))
    model = primitive_model("plate", plate)
    texture = np.zeros((64, 64, 3), dtype=np.uint8)
    texture[:32, :32], texture[:32, 32:] = (220, 30, 30), (30, 220, 30)  # top: red, green
    texture[32:, :32], texture[32:, 32:] = (30, 30, 220), (220, 220, 30)  # bottom: blue, yellow
    uv = (model.vertices[:, :2] / 0.2 + 0.5).astype(np.float32)
    model = dataclasses.replace(model, texture=texture, uv=uv)
    scene = Scene({"plate": model}, ALONE, Randomization.none())
    T_world_obj = place_objects(scene, plate=(0.0, 0.0, 0.4))["plate"]
    T = view_sphere_pose(np.zeros(3), 0.7, 0.3, 1.2)
    with closing(SceneRenderer(scene)) as renderer:
        rgb = renderer.render(T).rgb
    wanted = {(-1, 1): "red", (1, 1): "green", (-1, -1): "blue", (1, -1): "yellow"}
    for (x, y), name in wanted.items():
        point = T_world_obj @ (0.05 * x, 0.05 * y, 0.01, 1.0)
        u, v = cv_project(point[None, :3], T, LINEMOD_K)[0].round().astype(int)
        red, green, blue = rgb[v, u].astype(int)
        seen = {
            "red": red > 2 * max(green, blue),
            "green": green > 2 * max(red, blue),
            "blue": blue > 2 * max(red, green),
            "yellow": min(red, green) > 2 * blue,
        }
        assert seen[name], (name, rgb[v, u])


def test_the_quick_image_looks_like_mujocos_default_quality(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    place_objects(scene, brick=(0.0, 0.0, 0.3), post=(0.1, 0.1, 0.0), cone=(-0.1, 0.1, 0.0))
    T = view_sphere_pose(np.zeros(3), 0.8, 0.2, 0.8)
    quick = SceneRenderer(scene).render(T).rgb.astype(int)
    monkeypatch.setattr(graphics, "SAMPLES", 4)
    monkeypatch.setattr(graphics, "SHADOW_MAP_SIZE", 4096)
    slow = graphics.Graphics(scene.world, scene.data, scene.texture_versions)
    reference, _ = slow.read(slow.draw(T, LINEMOD_K, 480, 640))
    slow.close()
    difference = np.abs(quick - reference).max(axis=2)
    assert difference.mean() < 1.0
    assert np.mean(difference > 20) < 0.01  # outlines of things and of shadows


def test_shadows_and_absent_objects(scene: Scene) -> None:
    T = view_sphere_pose(np.zeros(3), 0.8, 0.2, 1.0)
    place_objects(scene, marker=(0.5, 0.3, 0.0))
    renderer = SceneRenderer(scene)
    empty = renderer.render(T).rgb.astype(int)
    place_objects(scene, marker=(0.5, 0.3, 0.0), post=(0.0, 0.0, 0.0))
    frame = renderer.render(T, masks=True)
    darker = (empty - frame.rgb).min(axis=2) > 8
    assert np.count_nonzero(darker & (frame.instances < 0)) > 300  # the post's shadow
    place_objects(scene, marker=(0.5, 0.3, 0.0))
    np.testing.assert_array_equal(renderer.render(T).rgb, empty)


def test_closing_frees_and_rendering_opens_again(scene: Scene) -> None:
    place_objects(scene, brick=(0.0, 0.0, 0.3))
    T = view_sphere_pose(np.zeros(3), 0.8, 0.2, 0.8)
    renderer = SceneRenderer(scene, 96, 128)
    first = renderer.render(T).rgb
    for _ in range(3):
        renderer.close()
        gc.collect()
        np.testing.assert_array_equal(renderer.render(T).rgb, first)
    renderer.close()
    renderer.close()


def test_images_larger_than_the_buffer(scene: Scene) -> None:
    place_objects(scene, brick=(0.0, 0.0, 0.3))
    T = view_sphere_pose(np.zeros(3), 0.8, 0.2, 0.8)
    K = np.array([[900.0, 0, 511.5], [0, 900.0, 359.5], [0, 0, 1]])
    frame = SceneRenderer(scene, 720, 1024).render(T, K, masks=True)
    assert frame.rgb.shape == (720, 1024, 3)
    assert np.count_nonzero(frame.instances == 0) > 5000


def test_wrong_input_is_refused(scene: Scene) -> None:
    renderer = SceneRenderer(scene, 32, 32)
    with pytest.raises(ValueError, match="K must be a 3x3"):
        renderer.render(np.eye(4), np.eye(4))
    with pytest.raises(ValueError, match="skew"):
        renderer.render(np.eye(4), LINEMOD_K + np.array([[0, 5, 0], [0, 0, 0], [0, 0, 0]]))
    with pytest.raises(ValueError, match="T_cam_world is not rigid"):
        renderer.render(np.diag([2.0, 1, 1, 1]))
    for size in (0, 5000, 12.5):
        with pytest.raises(ValueError, match="height"):
            SceneRenderer(scene, size, 32)


def test_large_silhouettes_are_complete_and_do_not_enlarge_the_buffer(scene: Scene) -> None:
    """A window of three by two and a half buffers is what its parts are, one by one."""
    place_objects(scene, brick=(0.0, 0.0, 0.4))
    T_cam_world = look_at(np.array([0.12, 0.1, 0.14]), np.zeros(3))
    K = LINEMOD_K * [[2.0, 1, 1], [1, 2.0, 1], [1, 1, 1]] + [
        [0, 0, 600.0],
        [0, 0, 400.0],
        [0, 0, 0],
    ]
    geom = scene.world.object_geoms[scene.world.object_names.index("brick")]
    scene.graphics.close()  # another test may have enlarged it
    whole = scene.graphics.silhouette(geom, T_cam_world, K, 1200, 1800)
    assert scene.graphics.buffer_size == (480, 640) and scene.state is not None
    rows, columns = np.nonzero(whole)
    assert np.ptp(rows) > 480 and np.ptp(columns) > 640  # it lies in several parts
    for top, left in ((300, 500), (470, 630), (700, 1000)):
        shifted = K - [[0, 0, left], [0, 0, top], [0, 0, 0]]
        part = scene.graphics.silhouette(geom, T_cam_world, shifted, 200, 300)
        assert (part != whole[top : top + 200, left : left + 300]).mean() < 1e-4
    points = scene.state.T_world_obj["brick"][:3, :3] @ scene.objects["brick"].vertices.T
    outline = cv_project(points.T + scene.state.T_world_obj["brick"][:3, 3], T_cam_world, K)
    hull = cv2.convexHull(outline.astype(np.float32)).round().astype(np.int32)
    drawn = cv2.fillPoly(np.zeros(whole.shape, np.uint8), [hull], 1) > 0
    assert (drawn & whole).sum() / (drawn | whole).sum() > 0.99
