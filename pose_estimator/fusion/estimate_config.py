"""The options of ``estimate``."""

from dataclasses import dataclass
from pathlib import Path

from ..methods import DEFAULT_METHOD


@dataclass(frozen=True)
class EstimateConfig:
    """Estimates the pose of a known object from two images (or one) of a calibrated camera.

    The pose is in the camera frame of the reference image: OpenCV axes (x right, y down, z
    forward), meters.
    """

    reference: Path
    """The first image."""
    object: str
    """Name of the object, as the weights know it."""
    K: str
    """Camera matrix of both images in pixels: fx,fy,cx,cy, a file (.json, .txt, .npy, .npz, .yaml,
    .xml) with the 3x3 matrix, BOP's camera.json, or `linemod` for LineMOD's camera."""
    second: Path | None = None
    """The second image; without it the pose is estimated from one view."""
    relative_pose: Path | None = None
    """File (.json, .txt, .npy, .npz, .yaml, .xml) with the 4x4 or 3x4 matrix T_second_reference in
    meters: it maps points in the reference camera's frame to the second camera's frame."""
    method: str = DEFAULT_METHOD
    """Estimator: `mid-pnp`, `mid`, `pnp`, `early`, `late` (two views), `single`, or `rgbd` (which
    needs --depth)."""
    depth: Path | None = None
    """Depth map of the reference image for `rgbd`, aligned with it: a 16-bit PNG or TIFF, or
    a .npy; 0, NaN and infinity = unknown."""
    depth_unit: float | None = None
    """Meters per unit of the depth map; none = that of its BOP dataset if it is in one, else 0.001
    for integers, 1 for floats."""
    weights: str = "linemod"
    """Name of shipped weights, or a file."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU if there is one, else the CPU), `cpu`, `cuda`, `cuda:N` or
    `mps`."""
    out: Path = Path("pose.json")
    """Write the pose here."""
    overlay: Path | None = Path("overlay.png")
    """Write the images with the model's outline here."""
    json: Path | None = None
    """Results file with the scores and the runtime."""
