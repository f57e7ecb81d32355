"""The command ``estimate``: the pose of an object in a user's own images."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from ...core.device import check_device
from ...core.errors import InputError
from ...core.files import write_atomically
from ...core.geometry import LINEMOD_K, View, check_intrinsics, check_rigid
from ...core.images import read_image
from ...core.results import write_results
from ..bop.depth_unit import stored_depth_unit
from ..input_files import DepthMap, read_depth_map, read_matrix
from ..methods import DEFAULT_METHOD, METHOD_TABLE, find_method

if TYPE_CHECKING:
    from ..types import PoseEstimate


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
    """Camera matrix of both images in pixels: fx,fy,cx,cy or a file (.json, .txt, .npy) with
    the 3x3 matrix, or `linemod` for LineMOD's camera."""
    second: Path | None = None
    """The second image; without it the pose is estimated from one view."""
    relative_pose: Path | None = None
    """File (.json, .txt, .npy) with the 4x4 matrix T_second_reference in meters: it maps points in
    the reference camera's frame to the second camera's frame."""
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


def parse_intrinsics(text: str) -> np.ndarray:
    """Returns the camera matrix (3, 3) given by ``--K``.

    Raises:
        InputError: if it is malformed.
        FileNotFoundError: if it names a file that does not exist.
    """
    if text == "linemod":
        return np.array(LINEMOD_K)
    parts = text.split(",")
    if len(parts) == 4:
        try:
            fx, fy, cx, cy = map(float, parts)
        except ValueError as error:
            raise InputError(f"K must be four numbers fx,fy,cx,cy, got {text!r}") from error
        return check_intrinsics(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]))
    path = Path(text)
    if not path.exists():
        raise FileNotFoundError(
            f"K must be fx,fy,cx,cy, 'linemod' or a file with a 3x3 matrix; "
            f"{text!r} is neither and no such file exists"
        )
    return check_intrinsics(read_matrix(path, "K", ("K", "cam_K")))


def read_depth(config: EstimateConfig) -> DepthMap | None:
    """Reads the depth map that a method with depth needs; None for others.

    Raises:
        FileNotFoundError: if the file is missing.
        InputError: if it is malformed, or goes with another method.
    """
    if find_method(config.method).needs_depth != (config.depth is not None):
        needing = " or ".join(m.name for m in METHOD_TABLE.values() if m.needs_depth)
        raise InputError(
            f"depth and the method {needing} go together: it needs a depth map of the reference "
            f"image, and no other method uses one (method is {config.method})"
        )
    if config.depth is None:
        return None
    given = config.depth_unit is not None
    return read_depth_map(
        config.depth, config.depth_unit if given else stored_depth_unit(config.depth)
    )


def read_views(config: EstimateConfig, depth: np.ndarray | None = None) -> list[View]:
    """Reads the images and cameras; the world is the reference camera's frame.

    ``depth`` is the map of the reference, (H, W) meters.

    Raises:
        FileNotFoundError: if a file is missing.
        InputError: if an input is malformed or the inputs disagree.
    """
    if (config.second is None) != (config.relative_pose is None):
        raise InputError("second and relative_pose go together: give both, or neither for one view")
    K = parse_intrinsics(config.K)
    views = [View(read_image(config.reference), K, np.eye(4), depth)]
    if config.second is not None and config.relative_pose is not None:
        image = read_image(config.second)
        if image.shape != views[0].image.shape:
            sizes = [f"{a.shape[1]}x{a.shape[0]}" for a in (views[0].image, image)]
            raise InputError(
                "reference and second must have the same size, since K is that of both: "
                f"reference is {sizes[0]}, second is {sizes[1]}"
            )
        T = read_matrix(config.relative_pose, "relative_pose", ("T_second_reference",))
        views.append(View(image, K, check_rigid(T, "relative_pose")))
    height, width = views[0].image.shape[:2]
    if not (0 <= K[0, 2] < width and 0 <= K[1, 2] < height):
        raise InputError(
            f"K has its principal point at ({K[0, 2]:g}, {K[1, 2]:g}), outside the {width}x{height}"
            " images; is it for another size?"
        )
    return views


def describe(answer: PoseEstimate, config: EstimateConfig) -> dict[str, Any]:
    """Returns the content of ``--out``."""
    deviation = np.sqrt(np.trace(answer.keypoint_covariance, axis1=1, axis2=2))
    return {
        "object": config.object,
        "method": config.method,
        "T_cam_obj": [[round(x, 9) for x in row] for row in answer.T_cam_obj.tolist()],
        "keypoints_m": answer.keypoints.tolist(),
        "keypoint_deviation_m": deviation.tolist(),
        "regions": [
            {"center": [float(x) for x in roi.center], "side": float(roi.side), "score": roi.score}
            for roi in answer.rois
        ],
    }


def estimate_files(config: EstimateConfig) -> None:
    """Estimates, prints and writes the pose, and draws it into the images.

    Raises:
        FileNotFoundError: if a file is missing.
        InputError: if an input is wrong; the message names it.
    """
    check_device(config.device)
    depth = read_depth(config)
    views = read_views(config, None if depth is None else depth.meters)
    # Only with valid inputs: this imports torch.
    from ..visualization import ESTIMATE_COLOR, draw_poses
    from .depth_agreement import check_depth_use
    from .loading import load

    estimator = load(config.method, config.weights, device=config.device)
    started = perf_counter()
    answer = estimator.estimate(views, config.object)
    seconds = perf_counter() - started
    if depth is not None and config.depth is not None and answer.depth_use is not None:
        check_depth_use(answer.depth_use, config.object, config.depth, depth)

    found = describe(answer, config)
    write_atomically(config.out, (json.dumps(found, indent=1) + "\n").encode())
    x, y, z = answer.T_cam_obj[:3, 3]
    print(f"{config.object} at x {x:+.4f}, y {y:+.4f}, z {z:+.4f} m in the reference camera")
    deviation = 1e3 * np.mean(found["keypoint_deviation_m"])
    print(f"keypoint uncertainty: {deviation:.1f} mm on average")
    if depth is not None:
        print(f"depth: read in units of {depth.unit:g} m")
    print(f"pose: {config.out}")
    if config.overlay is not None:
        model = estimator.networks.objects[config.object]
        poses = [{ESTIMATE_COLOR: view.T_cam_world @ answer.T_cam_obj} for view in views]
        pairs = zip(views, poses, strict=True)
        images = [draw_poses(view.image, model, pose, view.K) for view, pose in pairs]
        config.overlay.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.hstack(images)).save(config.overlay)
        print(f"overlay: {config.overlay}")
    if config.json is not None:
        tags = {"object": config.object, "method": config.method}
        records: list[dict[str, Any]] = [
            {"metric": "seconds_per_pair", "value": seconds, "unit": "s", **tags},
            *(
                {"metric": "detection_score", "value": roi.score, "unit": "1", "view": i, **tags}
                for i, roi in enumerate(answer.rois)
            ),
        ]
        command = f"estimate --object {config.object} --method {config.method}"
        write_results(config.json, records, command=command, seed=None)
