"""Whether a depth map shows an object, and where the color image does."""

from pathlib import Path

from ...core.errors import InputError
from ..input_files import DepthMap
from ..networks.point_cloud import MIN_POINTS
from ..types import DepthUse

_MAX_RATIO = 2.0
"""Largest plausible ratio of an object's distances in both images; its size in the image is less
than ten percent off."""

_MIN_SHARE = 0.1
"""Smallest share of an object's pixels with known depth; those at its rim show what is behind."""


def agrees(use: DepthUse) -> bool:
    """Whether the depth map puts the object where its size in the color image does."""
    return use.distance is None or 1 / _MAX_RATIO < use.distance / use.expected < _MAX_RATIO


def enough(use: DepthUse) -> bool:
    """Whether the depth map shows enough of the object."""
    return use.points >= MIN_POINTS and use.share >= _MIN_SHARE


def check_depth_use(use: DepthUse, object_name: str, path: Path, depth: DepthMap) -> None:
    """Refuses an answer for which the depth map was of no use.

    Args:
        use: what the estimator saw of the object.
        object_name: the object.
        path: of the depth map, for errors.
        depth: the map that was read from it.

    Raises:
        InputError: if the depths contradict the color image, or are too few.
    """
    if use.distance is not None and not agrees(use):
        ratio = use.distance / use.expected
        raise InputError(
            f"depth {path} puts {object_name} {use.distance:.3g} m away, its size in the image "
            f"{use.expected:.3g} m ({ratio:.2g} times): was it read in the right unit "
            f"({depth.unit:g} m; --depth-unit {depth.unit / ratio:.1g} would fit), and is it "
            "registered to the reference image?"
        )
    if not enough(use):
        raise InputError(
            f"depth {path} knows {use.points} points of {object_name}, {100 * use.share:.0f} % of "
            f"its pixels, and rgbd needs {MIN_POINTS} and {100 * _MIN_SHARE:.0f} %: is it of the "
            "reference image, and in the sensor's range? --method single needs no depth"
        )
