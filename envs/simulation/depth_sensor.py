"""Noise model of a structured-light depth sensor (LineMOD's Kinect): noise, steps and holes.

Depth is triangulated from the disparity between a projector and a camera. It is quantized in steps
that grow with the square of the distance, and missing in the projector's shadow, at grazing angles,
and next to depth edges.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.stats import norm

from ...core.errors import InputError
from ...core.geometry import check_depth, check_intrinsics
from ...core.validation import require_within

_GRAZING_SOFTNESS = np.deg2rad(2.0)
"""Scale of the logistic curve by which pixels are lost at grazing angles."""


@dataclass(frozen=True)
class DepthSensorConfig:
    """Parameters of the sensor.

    Attributes:
        axial: standard deviation along z, as a multiple of Nguyen et al.'s.
        lateral: standard deviation of edge positions, as a multiple of Nguyen et al.'s.
        correlation: standard deviation in pixels of the matching window, within which errors are
            correlated.
        disparity_step: quantization step of the disparity, pixels; 0 for none.
        baseline: from the camera to the projector on its right, meters; 0 for no shadows.
        grazing: angle in degrees between surface normal and ray at which half the pixels are lost.
        edge_loss: fraction of the pixels next to a depth edge that are lost.
        min_depth: meters.
        max_depth: meters.
    """

    axial: float = 1.0
    lateral: float = 1.0
    correlation: float = 1.0
    disparity_step: float = 0.125
    baseline: float = 0.075
    grazing: float = 80.0
    edge_loss: float = 0.5
    min_depth: float = 0.4
    max_depth: float = 5.0

    def __post_init__(self) -> None:
        names = ("axial", "lateral", "correlation", "disparity_step", "baseline", "min_depth")
        require_within(self, 0, np.inf, *names)
        require_within(self, 0, 1, "edge_loss")
        if not 0 < self.grazing <= 90:
            raise InputError(f"grazing must be > 0 and <= 90 degrees, got {self.grazing}")
        if not self.min_depth < self.max_depth:
            raise InputError(
                f"max_depth must be > min_depth {self.min_depth}, got {self.max_depth}"
            )
        if self.disparity_step > 0 and self.baseline == 0:
            raise InputError("disparity_step needs a baseline > 0, got 0")


def axial_deviation(depth: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Returns the Kinect's standard deviation along z, meters.

    Nguyen, Izadi and Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and
    tracking", 3DIMPVT 2012, equations 2 and 3.

    Args:
        depth: meters, any shape.
        angle: between surface normal and ray, radians, same shape.
    """
    z = np.maximum(depth, 0.1)
    frontal = 0.0012 + 0.0019 * (z - 0.4) ** 2
    angle = np.minimum(angle, np.deg2rad(85.0))
    tilted = 0.0001 / np.sqrt(z) * (angle / (np.pi / 2 - angle)) ** 2
    return frontal + np.where(angle > np.deg2rad(60.0), tilted, 0.0)


def viewing_angles(depth: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Returns the angles (H, W) in radians between surface normals and viewing rays.

    Slopes are the smaller of the two one-sided differences: at the boundary of a surface, the one
    to the neighbor on the same surface.
    """
    z = np.maximum(depth, 1e-6)
    slope_u, slope_v = _min_slope(z, 1), _min_slope(z, 0)
    rows, columns = np.indices(depth.shape, dtype=np.float32)
    x, y = (columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1]
    across, down = K[0, 0] * slope_u, K[1, 1] * slope_v
    # The normal of z(u, v) is (across, down, -(z + x across + y down)); its product with the ray
    # (x, y, 1) is -z.
    normal = np.sqrt(across**2 + down**2 + (z + x * across + y * down) ** 2)
    return np.arccos(np.clip(z / (normal * np.sqrt(x**2 + y**2 + 1)), 0, 1))


def apply_depth_sensor(
    depth: np.ndarray, K: np.ndarray, config: DepthSensorConfig, rng: np.random.Generator
) -> np.ndarray:
    """Applies the sensor model to an exact depth map.

    Args:
        depth: exact depth along z, (H, W) meters, 0 where there is none.
        K: camera matrix, (3, 3) pixels.
        config: the sensor.
        rng: source of all noise.

    Returns:
        (H, W) float32 meters, 0 where depth is missing.

    Raises:
        InputError: if the depth map or the camera matrix is invalid.
    """
    exact = check_depth(depth, np.shape(depth)[:2])
    K = check_intrinsics(K)
    angle = viewing_angles(exact, K)
    limit = np.deg2rad(config.grazing)
    # A depth edge is a step larger than that of a surface at the grazing limit.
    edge = _max_step(exact) > exact * (np.tan(min(limit, 1.55)) / K[0, 0])
    seen = _with_jittered_edges(exact, edge, angle, config, rng)

    noise = config.axial * axial_deviation(seen, angle)
    focal = K[0, 0] * config.baseline
    if config.disparity_step > 0:
        # The measured noise includes quantization, whose variance is step^2 / 12.
        step = config.disparity_step * seen**2 / focal
        noise = np.sqrt(np.maximum(noise**2 - config.axial**2 * step**2 / 12, 0))
    out = seen + noise * _smooth_noise(exact.shape, config.correlation, rng)
    if config.disparity_step > 0:
        disparity = focal / np.maximum(out, 1e-3)
        steps = np.maximum(np.round(disparity / config.disparity_step), 1)
        out = focal / (steps * config.disparity_step)

    lost = rng.random(exact.shape, np.float32) < 1 / (
        1 + np.exp(np.clip((limit - angle) / _GRAZING_SOFTNESS, -40, 40))
    )
    # Next to depth edges, the matching fails in patches.
    uniform = norm.cdf(_smooth_noise(exact.shape, config.correlation, rng))
    lost |= _dilated(edge, 1) & (uniform < config.edge_loss)
    if config.baseline > 0:
        lost |= projector_shadow(exact, K, config.baseline)
    lost |= (seen <= 0) | (out < config.min_depth) | (out > config.max_depth)
    return np.where(lost, 0, out).astype(np.float32)


def projector_shadow(depth: np.ndarray, K: np.ndarray, baseline: float) -> np.ndarray:
    """Returns which pixels (H, W) a projector on the camera's right does not illuminate.

    Along a row, projector columns increase with camera columns, except where a nearer surface on
    the right casts a shadow.
    """
    columns = np.arange(depth.shape[1], dtype=np.float32)
    in_projector = columns - K[0, 0] * baseline / np.where(depth > 0, depth, np.inf)
    min_right = np.minimum.accumulate(in_projector[:, ::-1], axis=1)[:, ::-1]
    return in_projector > min_right + 0.5  # half a pixel is not a shadow


def _with_jittered_edges(
    depth: np.ndarray,
    edge: np.ndarray,
    angle: np.ndarray,
    config: DepthSensorConfig,
    rng: np.random.Generator,
) -> np.ndarray:
    """Adds lateral noise (Nguyen et al., equation 1): pixels near edges may see the other surface.

    Within a surface, the axial noise already covers it.
    """
    tilted = np.minimum(angle, np.deg2rad(80.0))
    deviation = config.lateral * (0.8 + 0.035 * tilted / (np.pi / 2 - tilted))
    rows, columns = (
        np.clip(np.rint(index + deviation * noise).astype(int), 0, size - 1)
        for index, noise, size in zip(
            np.indices(depth.shape),
            [_smooth_noise(depth.shape, config.correlation, rng) for _ in range(2)],
            depth.shape,
            strict=True,
        )
    )
    return np.where(_dilated(edge, 3), depth[rows, columns], depth)


def _smooth_noise(
    shape: tuple[int, ...], correlation: float, rng: np.random.Generator
) -> np.ndarray:
    """Samples unit-variance Gaussian noise, correlated within a window."""
    noise = rng.standard_normal(shape, dtype=np.float32)
    if correlation == 0:
        return noise
    kernel = cv2.getGaussianKernel(2 * int(np.ceil(3 * correlation)) + 1, correlation, cv2.CV_32F)
    smooth = cv2.sepFilter2D(noise, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
    return smooth / np.float32((kernel**2).sum())


def _min_slope(z: np.ndarray, axis: int) -> np.ndarray:
    """Returns the smaller of the differences (H, W) to the two neighbors along an axis."""
    lines = np.moveaxis(z, axis, 0)
    steps = np.diff(lines, axis=0)
    before = np.concatenate([steps[:1], steps])
    after = np.concatenate([steps, steps[-1:]])
    return np.moveaxis(np.where(np.abs(before) < np.abs(after), before, after), 0, axis)


def _max_step(depth: np.ndarray) -> np.ndarray:
    """Returns the largest difference (H, W) to the four neighbors."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    return np.maximum(cv2.dilate(depth, cross) - depth, depth - cv2.erode(depth, cross))


def _dilated(mask: np.ndarray, pixels: int) -> np.ndarray:
    square = np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)
    return cv2.dilate(mask.astype(np.uint8), square).astype(bool)
