"""Synthetic view banks from which a policy can learn something."""

from __future__ import annotations

import numpy as np
from two_view_pose.core.geometry import LINEMOD_K
from two_view_pose.envs.observation import SpherePosition
from two_view_pose.envs.simulation.camera import view_sphere_pose
from two_view_pose.envs.two_view_pose import CANDIDATE_VIEWS
from two_view_pose.envs.view_banks.bank import BankHeader, ViewBank


def made_bank(scenes: int, seed: int = 0, size: int = 36) -> ViewBank:
    """Makes a bank.

    A red bar in the image stands left or right of the middle, and the views from its side fail:
    what a policy can learn. The first estimates are wrong; later ones are uncertain where wrong.
    """
    rng = np.random.default_rng(seed)
    names = ("cat", "duck", "iron")
    views = np.deg2rad(CANDIDATE_VIEWS)
    slots = len(views)
    center = rng.uniform((-0.1, -0.1, 0.02), (0.1, 0.1, 0.06), (scenes, 3))
    distance = rng.uniform(0.7, 1.3, scenes)
    azimuth = rng.uniform(-np.pi, np.pi, scenes)
    elevation = rng.uniform(0.3, 1.2, scenes)
    reference = np.stack(
        [
            view_sphere_pose(*where)
            for where in zip(center, distance, azimuth, elevation, strict=True)
        ]
    )
    second = np.stack(
        [
            [view_sphere_pose(c, d, a + offset, height) for offset, height in views]
            for c, d, a in zip(center, distance, azimuth, strict=True)
        ]
    )
    T_world_obj = np.tile(np.eye(4), (scenes, 1, 1))
    T_world_obj[:, :3, 3] = center
    T_cam_obj = reference @ T_world_obj
    left = rng.integers(2, size=scenes).astype(bool)
    blocked = np.where(left[:, None], views[:, 0] < 0, views[:, 0] > 0)
    error = np.where(blocked, 0.6, 0.03) + rng.uniform(0, 0.02, (scenes, slots))
    image = rng.integers(90, 110, (scenes, size, size, 3)).astype(np.uint8)
    bar = np.where(left, size // 4, 3 * size // 4)
    for i in range(scenes):
        image[i, :, bar[i] - 3 : bar[i] + 3] = (220, 30, 30)
    one_hot = np.eye(3, dtype=np.float32)[rng.integers(3, size=scenes)]
    log_sigma = np.where(error < 0.1, -0.8, 0.9).astype(np.float32)

    def camera(T: np.ndarray, middle: np.ndarray, start: float) -> np.ndarray:
        place = SpherePosition.of(T, middle)
        offset = place.azimuth - start
        angles = (place.elevation, offset, place.roll)
        return np.array([place.distance, *(f(a) for a in angles for f in (np.sin, np.cos))])

    rotation = T_cam_obj[:, :3, :2].transpose(0, 2, 1).reshape(scenes, 6).astype(np.float32)
    first_camera = [camera(T, c, a) for T, c, a in zip(reference, center, azimuth, strict=True)]
    second_camera = [
        [camera(T, c, a) for T in row] for row, c, a in zip(second, center, azimuth, strict=True)
    ]
    centers = -np.einsum("mnji,mnj->mni", second[..., :3, :3], second[..., :3, 3])
    start = -np.einsum("mji,mj->mi", reference[:, :3, :3], reference[:, :3, 3])

    def every_slot(array: np.ndarray) -> np.ndarray:
        return np.repeat(array[:, None], slots, axis=1).astype(np.float32)

    return ViewBank(
        header=BankHeader(
            source="simulation",
            scene="occlusion",
            object_names=names,
            diameters=(0.15, 0.11, 0.28),
            candidate_views=CANDIDATE_VIEWS,
            estimator="none",
            seed=seed,
        ),
        first={
            "rotation": rotation,
            "translation": T_cam_obj[:, :3, 3].astype(np.float32),
            "uncertainty": np.full((scenes, 9), 0.9, np.float32),
            "score": np.full((scenes, 1), 0.5, np.float32),
            "object": one_hot,
            "camera": np.array(first_camera, np.float32),
            "image": image,
        },
        second={
            "rotation": every_slot(rotation),
            "translation": every_slot(T_cam_obj[:, :3, 3]),
            "uncertainty": np.repeat(log_sigma[..., None], 9, axis=2),
            "score": np.full((scenes, slots, 1), 0.5, np.float32),
            "camera": np.array(second_camera, np.float32),
        },
        object_index=one_hot.argmax(axis=1).astype(np.int16),
        scene_seed=np.arange(100, 100 + scenes),
        visibility=rng.uniform(0.2, 1.0, scenes).astype(np.float32),
        T_cam_obj=T_cam_obj,
        keypoints=np.repeat(T_cam_obj[:, None, :3, 3], 9, axis=1).astype(np.float32),
        covariance=np.tile(1e-4 * np.eye(3, dtype=np.float32), (scenes, 9, 1, 1)),
        K=np.tile(LINEMOD_K, (scenes, 1, 1)),
        T_cam_world=reference,
        center=center,
        first_error=np.full(scenes, 0.5, np.float32),
        second_T_cam_world=second,
        second_T_cam_obj=np.repeat(T_cam_obj[:, None], slots, axis=1),
        second_error=error.astype(np.float32),
        second_visibility=np.where(blocked, 0.1, 0.95).astype(np.float32),
        travel=np.linalg.norm(centers - start[:, None], axis=2).astype(np.float32),
    )
