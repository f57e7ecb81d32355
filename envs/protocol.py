"""The interface between the environments and whatever estimates the pose."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Protocol, runtime_checkable

from ..core.device import resolve_device
from ..core.errors import InputError
from ..core.geometry import View
from ..pose_estimator.types import PoseEstimate


@runtime_checkable
class PoseEstimator(Protocol):
    """Anything that estimates the pose of an object from one or two views of it.

    A caller's own estimator needs ``estimate`` only. If it also has ``object_names``, the
    environment refuses objects that are not among them. If it has ``estimate_batch(requests)``,
    which takes a list of (views, object name) and returns what ``estimate`` does for each, it is
    called once for many pairs of views; and by vector environments from two threads if its
    ``thread_safe`` is true.
    """

    def estimate(self, views: Sequence[View], object_name: str) -> PoseEstimate:
        """Estimates the object's pose in the first (reference) camera.

        Args:
            views: the reference view, then the second view if there is one. Their ``T_cam_world``
                share one world frame; nothing else is known about it.
            object_name: the object to look for.

        Returns:
            A pose, always: a poor one rather than none.
        """
        ...


@cache
def _load(method: str, device: str) -> PoseEstimator:
    """Loads shipped weights once a process and device, for all its environments."""
    from .. import pose_estimator

    return pose_estimator.load(method, device=device)


def resolve_estimator(
    estimator: str | Path | PoseEstimator | None, device: str = "auto"
) -> PoseEstimator | None:
    """Turns the environment's ``estimator`` argument into an estimator.

    Args:
        estimator: the name of a method whose shipped weights are loaded (``"mid"``,
            ``"single"``), a ``.safetensors`` file of your own for ``"mid"``, an object with an
            ``estimate`` method, or None for rendering only.
        device: where an estimator that is loaded here runs, see ``pose_estimator.load``. An object
            of your own has chosen its own; without an estimator it means nothing.

    Raises:
        InputError: if the estimator is none of these, there is no such device, or a device is given
            for an object of your own.
        FileNotFoundError: if there is no such file.
    """
    if estimator is None:
        return None
    if isinstance(estimator, str | Path):
        # One estimator for "auto" and the name of the same device.
        found = str(resolve_device(device))
        if Path(estimator).suffix != ".safetensors":
            return _load(str(estimator), found)
        from .. import pose_estimator

        return pose_estimator.load("mid", estimator, device=found)
    if not callable(getattr(estimator, "estimate", None)):
        raise InputError(
            "estimator must be the name of a method, a .safetensors file, an object with "
            f"estimate(views, object_name), or None; got {estimator!r}"
        )
    if device != "auto":
        raise InputError(
            "device is for an estimator that is loaded by name or from a file; your own object "
            f'runs where you made it: leave device at "auto", got {device!r}'
        )
    return estimator


def check_known_objects(estimator: PoseEstimator | None, object_names: Sequence[str]) -> None:
    """Refuses objects for which the estimator has not been trained.

    Raises:
        InputError: naming the unknown objects, the known ones and the training command.
    """
    known = getattr(estimator, "object_names", None)
    if known is None:
        return
    unknown = [name for name in object_names if name not in known]
    if unknown:
        raise InputError(
            f"the estimator does not know the object(s) {', '.join(unknown)}; it was trained on "
            f"{', '.join(known)}. Train one that does with `python -m two_view_pose "
            f"train-estimator --objects {' '.join(object_names)} --data DIR --init linemod --out "
            'DIR` and pass its weights as estimator="DIR/weights.safetensors", or pass '
            "estimator=None to render without estimating, or pass your own estimator"
        )
