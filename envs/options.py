"""The options of ``reset(options=...)``, and their validation."""

from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.geometry import check_rigid
from .simulation.camera import CameraRange, view_sphere_pose

OPTION_NAMES = ("object", "scene_seed", "reference_camera")
_SPHERE_NAMES = ("distance", "azimuth", "elevation")


def parse_reset_options(
    options: Mapping[str, Any] | None,
    object_names: Sequence[str],
    camera_range: CameraRange,
) -> tuple[int | None, str | None, np.ndarray | None]:
    """Validates the argument of ``reset``.

    Args:
        object_names: objects of the environment.
        camera_range: range of a reference camera given as a dict.

    Returns:
        Scene seed, object and T_cam_world (4, 4) of the reference camera; None for each that the
        options do not fix.

    Raises:
        InputError: if a key is unknown or a value is not allowed.
    """
    if not isinstance(options, Mapping | None):
        raise InputError(f"options must be a dict or None, got {type(options).__name__}")
    options = options or {}
    unknown = [key for key in options if key not in OPTION_NAMES]
    if unknown:
        raise InputError(
            f"unknown reset option(s) {unknown}; allowed are {', '.join(OPTION_NAMES)}"
        )
    name, seed, camera = map(options.get, OPTION_NAMES)
    if name is not None and name not in object_names:
        raise InputError(f"option object must be one of {', '.join(object_names)}; got {name!r}")
    if seed is not None:
        if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
            raise InputError(f"option scene_seed must be an integer >= 0, got {seed!r}")
        seed = int(seed)
    return seed, name, None if camera is None else _parse_camera(camera, camera_range)


def _parse_camera(camera: Any, allowed: CameraRange) -> np.ndarray:
    """T_cam_world (4, 4) from a matrix or a position on the sphere around the table's center."""
    if not isinstance(camera, Mapping):
        try:
            return check_rigid(camera, "option reference_camera")
        except (TypeError, ValueError) as error:
            raise InputError(
                "option reference_camera must be T_cam_world, a 4x4 rigid transform, or a dict of "
                f"{', '.join(_SPHERE_NAMES)}: {error}"
            ) from error
    if set(camera) != set(_SPHERE_NAMES):
        raise InputError(
            f"option reference_camera as a dict has the keys {', '.join(_SPHERE_NAMES)}; "
            f"got {', '.join(map(str, camera)) or 'none'}"
        )
    bounds = {
        "distance": (*allowed.distance, "m"),
        "azimuth": (-2 * np.pi, 2 * np.pi, "rad"),
        "elevation": (*allowed.elevation, "rad"),
    }
    for key, (low, high, unit) in bounds.items():
        value = camera[key]
        number = isinstance(value, Real) and not isinstance(value, bool)
        if not number or not low <= float(value) <= high:
            raise InputError(
                f"option reference_camera[{key!r}] must be {low:.4g} to {high:.4g} {unit}, "
                f"got {value!r}"
            )
    return view_sphere_pose(np.zeros(3), *(float(camera[key]) for key in _SPHERE_NAMES))
