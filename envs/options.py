"""The options of ``reset(options=...)``, and their validation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.geometry import check_rigid
from .simulation.camera import CameraRange, view_sphere_pose

OPTION_NAMES = ("object", "scene_seed", "reference_camera")
_SPHERE_NAMES = ("distance", "azimuth", "elevation")


@dataclass(frozen=True, eq=False)
class ResetOptions:
    """The checked options of one episode; None leaves a choice to the seed.

    Attributes:
        object: name of the target.
        scene_seed: seed of everything that is drawn in the episode.
        reference_camera: T_cam_world of the reference view, (4, 4).
    """

    object: str | None = None
    scene_seed: int | None = None
    reference_camera: np.ndarray | None = None

    @classmethod
    def parse(
        cls,
        options: Mapping[str, Any] | None,
        object_names: Sequence[str],
        camera_range: CameraRange,
    ) -> ResetOptions:
        """Checks what the caller of ``reset`` passed.

        Args:
            options: the argument of ``reset``.
            object_names: objects of this environment.
            camera_range: where a reference camera given as a dict may stand.

        Raises:
            InputError: if a key is unknown or a value is not allowed; the message says what is.
        """
        if options is None:
            return cls()
        if not isinstance(options, Mapping):
            raise InputError(f"options must be a dict or None, got {type(options).__name__}")
        unknown = [key for key in options if key not in OPTION_NAMES]
        if unknown:
            raise InputError(
                f"unknown reset option(s) {unknown}; allowed are {', '.join(OPTION_NAMES)}"
            )
        name, seed = options.get("object"), options.get("scene_seed")
        if name is not None and name not in object_names:
            raise InputError(
                f"option object must be one of {', '.join(object_names)}; got {name!r}"
            )
        if seed is not None:
            if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
                raise InputError(f"option scene_seed must be an integer >= 0, got {seed!r}")
            seed = int(seed)
        camera = options.get("reference_camera")
        return cls(name, seed, None if camera is None else _parse_camera(camera, camera_range))


def _parse_camera(camera: Any, allowed: CameraRange) -> np.ndarray:
    """T_cam_world (4, 4) from a matrix or a position on the sphere around the table's middle."""
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
                f"option reference_camera[{key!r}] must be a number within "
                f"{low:.4g} to {high:.4g} {unit}, got {value!r}"
            )
    return view_sphere_pose(np.zeros(3), *(float(camera[key]) for key in _SPHERE_NAMES))
