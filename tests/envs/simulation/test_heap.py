"""Heaps: all there, close together, standing by themselves, and as hidden as in LM-O."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.geometry import LINEMOD_K, invert, project, transform
from two_view_pose.envs.simulation.camera import view_sphere_pose
from two_view_pose.envs.simulation.randomization import Randomization
from two_view_pose.envs.simulation.scene import Scene, SceneConfig

pytestmark = pytest.mark.slow

LMO_REAL = {0.1: 0.38, 0.25: 0.64, 0.5: 0.90, 0.75: 0.97}
"""Quantiles of visib_fract in 40 frames of LM-O, of the 293 targets that have at least 0.1."""


@pytest.fixture(scope="module")
def heap(objects: dict[str, ObjectModel]) -> Iterator[Scene]:
    scene = Scene(objects, SceneConfig(kind="heap"), Randomization(textures=False))
    yield scene
    scene.graphics.close()


def test_all_objects_are_close_together_and_in_the_image(
    heap: Scene, objects: dict[str, ObjectModel]
) -> None:
    inside = []
    for seed in range(6):
        state = heap.reset(np.random.default_rng(seed), "cone")
        assert state.T_world_obj.keys() == objects.keys()
        middles = np.array([T[:2, 3] for T in state.T_world_obj.values()])
        apart = np.linalg.norm(middles[:, None] - middles[None], axis=2)
        np.fill_diagonal(apart, np.inf)
        assert apart.min(axis=1).max() < 0.16  # each has a neighbor at about its own size
        assert np.linalg.norm(middles - middles.mean(axis=0), axis=1).max() < 0.25
        for name, T in state.T_world_obj.items():
            np.testing.assert_allclose(T[2, :3], (0, 0, 1), atol=1e-6)
            points = transform(state.T_cam_world @ T, objects[name].vertices)
            uv = project(points, LINEMOD_K)
            inside.append(np.mean((uv >= 0) & (uv <= (639, 479))))
    assert np.mean(inside) > 0.97


def test_heap_scenes_are_stable_under_physics(heap: Scene) -> None:
    model, data = heap.world.model, heap.data
    for seed in range(2):
        state = heap.reset(np.random.default_rng(seed), "post")
        mujoco.mj_forward(model, data)
        assert data.contact.dist.min() > -2e-4  # nothing is inside anything
        for _ in range(round(0.4 / model.opt.timestep)):
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        for name, T in state.T_world_obj.items():
            moved = data.xpos[model.body(f"object:{name}").id] - T[:3, 3]
            assert np.linalg.norm(moved) < 0.004, name


def test_target_visibility_matches_lmo(heap: Scene) -> None:
    seen, elevations = [], []
    for seed in range(25):
        state = heap.reset(np.random.default_rng(seed), heap.object_names[seed % 6])
        K = LINEMOD_K.copy()
        K[:2] /= 2
        visibility = heap.visibility(heap.object_names, state.T_cam_world, K, 240, 320)
        target = visibility[heap.object_names.index(state.target)]
        assert target == pytest.approx(state.visibility, abs=0.12)
        seen += visibility.tolist()
        camera = invert(state.T_cam_world)[:3, 3]
        elevations.append(np.rad2deg(np.arcsin(camera[2] / np.linalg.norm(camera))))
    seen = np.array(seen)
    assert np.mean(seen < 0.1) < 0.06
    for probability, value in LMO_REAL.items():
        assert np.quantile(seen[seen >= 0.1], probability) == pytest.approx(value, abs=0.16)
    assert 24 < np.median(elevations) < 42  # LM-O: 32


def test_heap_scenes_are_deterministic_and_keep_a_given_camera(heap: Scene) -> None:
    first, again, other = (heap.reset(np.random.default_rng(s), "ring") for s in (2, 2, 3))
    np.testing.assert_array_equal(first.T_cam_world, again.T_cam_world)
    for name, T in first.T_world_obj.items():
        np.testing.assert_array_equal(T, again.T_world_obj[name])
        assert not np.array_equal(T, other.T_world_obj[name])
    T = view_sphere_pose(np.array([0.0, 0.0, 0.05]), 0.9, 0.4, 0.5)
    np.testing.assert_array_equal(heap.reset(np.random.default_rng(1), "ring", T).T_cam_world, T)


def test_clearance_is_the_distance_to_the_nearest_prop(heap: Scene) -> None:
    heap.reset(np.random.default_rng(0), "ball")
    props = heap.arrangement.placed()
    top = max(prop.rest.height for prop in props)
    assert heap.arrangement.clearance(np.array([[0.0, 0.0, top + 0.3]])) >= 0.3 - 1e-9
    ball = heap.arrangement.objects["ball"].placed
    above = np.append(ball.xy, 0.1 + 0.02)  # the ball is 10 cm high
    assert heap.arrangement.clearance(above[None]) <= 0.02 + 1e-6
    assert heap.arrangement.clearance(np.append(ball.xy, 0.05)[None]) < 0
