"""Camera motion and the error of its reading."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.estimators import pose
from scipy.spatial.transform import Rotation
from two_view_pose.envs.simulation.camera import camera_center
from two_view_pose.envs.simulation.carrier import FreeFlyingCarrier, PoseNoise


def looking_from(center: tuple[float, float, float]) -> np.ndarray:
    """T_cam_world of a turned camera at ``center``."""
    return np.linalg.inv(pose((0.3, -2.0, 1.0), center))


def test_free_flying_carrier_travels_straight():
    carrier = FreeFlyingCarrier()
    carrier.place(looking_from((1.0, 2.0, 3.0)))
    motion = carrier.move(looking_from((1.0, 5.0, 7.0)))
    assert motion.travel == pytest.approx(5.0)
    np.testing.assert_allclose(camera_center(motion.T_cam_world), (1.0, 5.0, 7.0))
    assert carrier.move(looking_from((1.0, 5.0, 6.0))).travel == pytest.approx(1.0)


def test_invalid_poses_are_refused():
    with pytest.raises(ValueError, match="T_cam_world"):
        FreeFlyingCarrier().place(2 * np.eye(4))
    with pytest.raises(ValueError, match="T_cam_world"):
        FreeFlyingCarrier().move(np.full((4, 4), np.nan))


def test_pose_noise_has_its_standard_deviation():
    rng = np.random.default_rng(0)
    T = looking_from((0.5, 0.2, 0.9))
    errors = np.stack(
        [PoseNoise(2.0, 0.01).perturb(T, rng) @ np.linalg.inv(T) for _ in range(4000)]
    )
    angles = np.rad2deg(Rotation.from_matrix(errors[:, :3, :3]).as_rotvec())
    np.testing.assert_allclose(angles.std(axis=0), 2.0, rtol=0.05)
    np.testing.assert_allclose(errors[:, :3, 3].std(axis=0), 0.01, rtol=0.05)
    np.testing.assert_allclose(angles.mean(axis=0), 0.0, atol=0.15)


def test_zero_pose_noise_is_identity():
    T = looking_from((0.5, 0.2, 0.9))
    np.testing.assert_array_equal(PoseNoise().perturb(T, np.random.default_rng(0)), T)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ((1.0,), "pose_noise must be"),
        ((1.0, 2.0, 3.0), "pose_noise must be"),
        ("much", "pose_noise must be"),
        ((-1.0, 0.0), "pose_noise.rotation_deg must be >= 0, got -1.0"),
        ((0.0, np.nan), "pose_noise.translation must be >= 0, got nan"),
        ((0.0, "1 cm"), "pose_noise.translation must be >= 0, got '1 cm'"),
    ],
)
def test_invalid_pose_noise_is_refused(noise, message):
    with pytest.raises(ValueError, match=message):
        PoseNoise.of(noise)
