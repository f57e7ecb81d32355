"""Two views of nine points whose votes are exact, as the volume gets them."""

import cv2
import numpy as np
import torch
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.geometry import make_transform
from two_view_pose.pose_estimator.lifting import KeypointPrior, ViewMaps, voxel_centres

K_GRID = np.array([[114.0, 0, 15.0], [0, 113.0, 16.2], [0, 0, 1]])
DIAMETER = 0.16
CENTRE = np.array([0.02, -0.03, 0.95])


def second_camera() -> np.ndarray:
    """T_second_ref: 30 degrees around the object, so that it stays in the middle."""
    rotation = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    return make_transform(rotation, np.array([0.01, -0.02, 1.0]) - rotation @ CENTRE)


def opencv_pixels(points: np.ndarray, T_cam_ref: np.ndarray) -> np.ndarray:
    turn, _ = cv2.Rodrigues(T_cam_ref[:3, :3])
    pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), turn, T_cam_ref[:3, 3], K_GRID, None)
    return pixels[:, 0]


def view_maps(
    keypoints: np.ndarray, deviation: float = 0.3, features: torch.Tensor | None = None
) -> ViewMaps:
    """Two views whose votes are exact."""
    cameras = [np.eye(4), second_camera()]
    votes = np.stack([opencv_pixels(keypoints, T) for T in cameras])
    if features is None:
        features = torch.zeros(1, 2, 4, 32, 32)
    return ViewMaps(
        features=features,
        projection=torch.from_numpy(np.stack([K_GRID @ T[:3] for T in cameras])).float()[None],
        vote_mean=torch.from_numpy(votes).float()[None],
        vote_covariance=torch.eye(2).expand(1, 2, 9, 2, 2) * deviation**2,
    )


def nine_keypoints() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.vstack([CENTRE + rng.uniform(-0.05, 0.05, (8, 3)), CENTRE])


def cube(half: float, count: int) -> torch.Tensor:
    return voxel_centres(torch.from_numpy(CENTRE).float()[None], torch.tensor([half]), count)


def flat_prior(keypoints: np.ndarray) -> KeypointPrior:
    """A joint pose that knows nothing but roughly where the object is."""
    mean = torch.from_numpy(keypoints + 0.02).float()[None]
    return KeypointPrior(mean, torch.eye(3).expand(1, 9, 3, 3) * 1.0)
