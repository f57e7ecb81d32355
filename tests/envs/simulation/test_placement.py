"""Footprints and packing against polygons' areas and physics."""

import cv2
import numpy as np
import pytest
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.envs.simulation.placement import (
    PlacedObject,
    is_collision_free,
    on_table,
    pack,
    resting_shape,
    separated,
    stable_poses,
)

SQUARE = 0.05 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)


def test_every_pose_rests_on_the_table_upright_first(objects: dict[str, ObjectModel]) -> None:
    for model in objects.values():
        poses = stable_poses(model)
        for rest in poses:
            T = rest.T_table_obj
            points = model.vertices @ T[:3, :3].T + T[:3, 3]
            assert points[:, 2].min() == pytest.approx(0.0, abs=1e-9)
            assert np.ptp(points[:, 2]) == pytest.approx(rest.height)
            assert np.linalg.norm(points[:, :2], axis=1).max() <= rest.radius + 1e-6
            area = cv2.contourArea(rest.footprint.astype(np.float32), oriented=True)
            assert area > 0  # counter-clockwise with y up
        np.testing.assert_allclose(poses[0].T_table_obj[2, :3], (0, 0, 1), atol=1e-9)


def test_a_pose_on_an_edge_is_left_out(objects: dict[str, ObjectModel]) -> None:
    brick = objects["brick"]
    turn = np.eye(4)
    angle = np.arctan2(0.12, 0.05)  # the weight acts exactly above the edge
    turn[:3, :3] = [
        [np.cos(angle), 0, np.sin(angle)],
        [0, 1, 0],
        [-np.sin(angle), 0, np.cos(angle)],
    ]
    poses = np.concatenate([brick.stable_poses, turn[None]])
    balanced = ObjectModel(**{**brick.__dict__, "stable_poses": poses})
    assert len(stable_poses(balanced)) == len(stable_poses(brick))


def test_separated_agrees_with_the_area_of_intersection() -> None:
    rng = np.random.default_rng(0)
    touching = 0
    for _ in range(300):
        a, b = (
            cv2.convexHull(rng.uniform(-0.1, 0.1, (6, 2)).astype(np.float32))[:, 0].astype(float)
            for _ in range(2)
        )
        b = b + rng.uniform(-0.2, 0.2, 2)
        overlap, _ = cv2.intersectConvexConvex(a.astype(np.float32), b.astype(np.float32))
        a, b = (p if cv2.contourArea(p.astype("f4"), True) > 0 else p[::-1] for p in (a, b))
        if overlap > 1e-6:
            touching += 1
            assert not separated(a, b, gap=0.0)
        elif overlap == 0:
            assert separated(a, b, gap=0.0)
    assert 50 < touching < 250


def test_separated_measures_the_gap_between_parallel_sides() -> None:
    assert separated(SQUARE, SQUARE + np.array([0.104, 0.02]), gap=0.003)
    assert not separated(SQUARE, SQUARE + np.array([0.102, 0.02]), gap=0.003)


@pytest.mark.slow
def test_packing_has_no_collisions() -> None:
    rng = np.random.default_rng(1)
    placed: list[PlacedObject] = []
    for _ in range(40):
        size = rng.uniform(0.02, 0.06, 3)
        thing = pack(rng, resting_shape("box", size), placed, np.zeros(2))
        if thing is not None:
            assert is_collision_free(thing, placed) and on_table(thing)
            placed.append(thing)
    assert len(placed) > 30
    for i, one in enumerate(placed):
        for other in placed[:i]:
            outlines = one.outline.astype(np.float32), other.outline.astype(np.float32)
            assert cv2.intersectConvexConvex(*outlines)[0] == 0


def test_pack_gives_up_where_the_table_ends() -> None:
    big = resting_shape("box", np.array([0.5, 0.5, 0.05]))  # half of a table of 1.8 x 1.4 m
    there = [PlacedObject(big, np.array([-0.4, 0.0]), 0.0)]
    assert pack(np.random.default_rng(0), big, there, np.zeros(2)) is None


def test_rotated_rotates_pose_and_outline() -> None:
    box = PlacedObject(
        resting_shape("box", np.array([0.05, 0.02, 0.03])), np.array([0.2, 0.1]), 0.4
    )
    turned = box.rotated(np.array([0.1, 0.0]), 0.7)
    corner = np.array([0.05, 0.02, 0.03, 1.0])
    np.testing.assert_allclose((turned.T_world_obj @ corner)[:2], turned.outline[2], atol=1e-12)
    before = np.linalg.norm(box.xy - (0.1, 0.0))
    assert np.linalg.norm(turned.xy - (0.1, 0.0)) == pytest.approx(before)
