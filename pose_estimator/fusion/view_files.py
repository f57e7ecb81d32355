"""Reads the views of the command ``estimate``: photographs, cameras and depth, which must agree."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...core.errors import InputError
from ...core.geometry import View
from ...core.images import read_photograph
from ..bop.depth_unit import stored_depth_unit
from ..camera_files import Intrinsics, parse_intrinsics, read_relative_pose
from ..input_files import DepthMap, read_depth_map
from ..methods import METHOD_TABLE, find_method
from .estimate_config import EstimateConfig
from .view_checks import check_cameras, check_photographs


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


def read_views(
    config: EstimateConfig, depth: np.ndarray | None = None
) -> tuple[list[View], list[str]]:
    """Reads the images and cameras; the world is the reference camera's frame.

    ``depth`` is the map of the reference, (H, W) meters.

    Returns:
        The views, and what is implausible about them.

    Raises:
        FileNotFoundError: if a file is missing.
        InputError: if an input is malformed or the inputs disagree.
    """
    if (config.second is None) != (config.relative_pose is None):
        raise InputError("second and relative_pose go together: give both, or neither for one view")
    camera = parse_intrinsics(config.K)
    paths = [config.reference] if config.second is None else [config.reference, config.second]
    images, doubts = _read_photographs(paths, with_depth=depth is not None)
    _check_size(camera, images[0])
    poses = [np.eye(4)]
    if config.relative_pose is not None:
        poses.append(read_relative_pose(config.relative_pose))
    views = [
        View(image, camera.K, T, depth if number == 0 else None)
        for number, (image, T) in enumerate(zip(images, poses, strict=True))
    ]
    doubts += check_cameras(views)
    return views, doubts + check_photographs(views, [str(path) for path in paths])


def _read_photographs(
    paths: Sequence[Path], *, with_depth: bool
) -> tuple[list[np.ndarray], list[str]]:
    """Reads photographs of one size, turned upright; also returns doubts about their orientation.

    Raises:
        InputError: if their sizes differ.
    """
    read = [read_photograph(path) for path in paths]
    images, orientations = [image for image, _ in read], [turned for _, turned in read]
    for path, (image, orientation) in zip(paths, read, strict=True):
        if orientation != 1:
            print(
                f"{path} has the EXIF orientation {orientation} and is turned upright, to "
                f"{image.shape[1]}x{image.shape[0]}; K, relative_pose and the result are those of "
                "the upright photograph, as OpenCV reads it"
            )
    differ = len(set(orientations)) > 1
    given = " and ".join(map(str, orientations))
    if len({image.shape for image in images}) > 1:
        sizes = [f"{image.shape[1]}x{image.shape[0]}" for image in images]
        hint = f" (after turning them by their EXIF orientations {given})" if differ else ""
        raise InputError(
            "reference and second must have the same size, since K is that of both: "
            f"reference is {sizes[0]}, second is {sizes[1]}{hint}"
        )
    doubts = []
    if differ:
        doubts.append(
            f"reference and second have different EXIF orientations ({given}): they are "
            "turned upright, so one K suits both only if its principal point is the image center, "
            "and relative_pose must be that of the upright photographs"
        )
    if with_depth and orientations[0] != 1:
        doubts.append(
            f"reference is turned by its EXIF orientation {orientations[0]}, and its depth map is "
            "not: it must show the upright photograph"
        )
    return images, doubts


def _check_size(camera: Intrinsics, image: np.ndarray) -> None:
    """Raises an InputError if the camera's file names another size than the photographs have."""
    height, width = image.shape[:2]
    if camera.size in (None, (height, width)):
        return
    assert camera.size is not None
    ratio = width / camera.size[1]
    same_shape = abs(height / camera.size[0] / ratio - 1) < 0.01
    hint = f"multiply fx, fy, cx and cy by {ratio:.4g}" if same_shape else "calibrate for them"
    raise InputError(
        f"K is that of images of {camera.size[1]}x{camera.size[0]}, the photographs have "
        f"{width}x{height}: {hint}"
    )
