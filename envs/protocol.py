"""The interface of a pose estimator, as the environments use it."""

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
    """Estimates the pose of an object from one or more views.

    Your own estimator needs ``estimate`` only. Optional: ``object_names``, the objects that it
    knows; ``estimate_batch(requests)``, which estimates a list of (views, object name) in one call;
    and ``thread_safe``: if true, vector environments call it from two threads.
    """

    def estimate(self, views: Sequence[View], object_name: str) -> PoseEstimate:
        """Estimates the object's pose in the first (reference) camera.

        Args:
            views: the reference view, then the second view if there is one. Their ``T_cam_world``
                share one arbitrary world frame.
            object_name: the target.

        Returns:
            A pose, always: a poor one rather than none.
        """
        ...


@cache
def load_shipped(method: str, device: str) -> PoseEstimator:
    """Loads shipped weights, once per process and device."""
    from .. import pose_estimator

    return pose_estimator.load(method, device=device)


def resolve_estimator(
    estimator: str | Path | PoseEstimator | None, device: str = "auto"
) -> PoseEstimator | None:
    """Converts the arguments ``estimator`` and ``device`` of ``TwoViewPoseEnv`` to an estimator.

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
        if Path(estimator).suffix.lower() != ".safetensors":
            return load_shipped(str(estimator), found)
        from .. import pose_estimator

        return pose_estimator.load(weights=estimator, device=found)
    if not callable(getattr(estimator, "estimate", None)):
        raise InputError(
            "estimator must be the name of a method, a .safetensors file, an object with "
            f"estimate(views, object_name), or None; got {estimator!r}"
        )
    if device != "auto":
        raise InputError(
            "device applies to an estimator loaded by name or from a file; for your own object "
            f'leave device at "auto", got {device!r}'
        )
    return estimator


def check_known_objects(estimator: PoseEstimator | None, object_names: Sequence[str]) -> None:
    """Checks that the estimator was trained on the objects.

    Raises:
        InputError: if not; with the unknown objects, the known ones and the training command.
    """
    known = getattr(estimator, "object_names", None)
    if known is None:
        return
    unknown = [name for name in object_names if name not in known]
    if unknown:
        raise InputError(
            f"the estimator does not know the object(s) {', '.join(unknown)}; it was trained on "
            f"{', '.join(known)}. Train one with `python -m two_view_pose train-estimator "
            f"--objects {' '.join(object_names)} --data DIR --init linemod --out DIR` and pass "
            'estimator="DIR/weights.safetensors", or pass estimator=None to render without '
            "estimating, or your own estimator"
        )
