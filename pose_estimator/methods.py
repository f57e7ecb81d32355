"""The table of estimation methods.

To add one, write its estimator in ``fusion/``, most often a
:class:`~.fusion.estimator.KeypointEstimator` with a ``fuse``, and a row here. Commands, the study
and its figures read the table. A method with a network of its own also needs the network's name in
``PARTS``, the network in ``networks/container.py`` and its stage in ``training/``.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from ..core.errors import InputError

PARTS = ("detector", "features", "volume", "cascade", "points")
"""The networks, in the order of their training."""

OPTIONAL_PARTS = ("cascade", "points")
"""Networks that weights may lack: those of ``early`` and ``rgbd``."""


@dataclass(frozen=True)
class Method:
    """One way to estimate a pose.

    Attributes:
        name: as commands and :func:`load` take it.
        summary: one line.
        views: how many it uses, 1 or 2 (and more).
        needs_depth: whether the reference view must have a depth map.
        parts: the networks that it runs, of ``PARTS``.
        estimator: its class, ``module:Class`` in this package.
        refine: how its pose is refined unless asked otherwise, one of ``REFINEMENTS``.
        color: in plots (after Okabe and Ito, for the color-blind).
        marker: in plots, as Matplotlib names it.
    """

    name: str
    summary: str
    views: int
    needs_depth: bool
    parts: tuple[str, ...]
    estimator: str
    color: str
    marker: str
    refine: str = "none"

    def estimator_class(self) -> type[Any]:
        """The class behind ``estimator``; imports torch."""
        module, name = self.estimator.split(":")
        return getattr(import_module(f".{module}", __package__), name)


METHOD_TABLE = {
    method.name: method
    for method in (
        Method(
            "single", "one view", 1, False, ("detector", "features"),
            "fusion.single:SingleViewEstimator", "#7a7f87", "v",
        ),
        Method(
            "early", "a depth map from two views", 2, False, ("detector", "features", "cascade"),
            "fusion.early:EarlyFusionEstimator", "#e69f00", "s",
        ),
        Method(
            "late", "triangulated votes of two views", 2, False, ("detector", "features"),
            "fusion.late:LateFusionEstimator", "#56a4d9", "D",
        ),
        Method(
            "mid", "Mid-Fusion of two views", 2, False, ("detector", "features", "volume"),
            "fusion.mid:MidFusionEstimator", "#c8401e", "o",
        ),
        Method(
            "pnp", "one pose for the votes of two views", 2, False, ("detector", "features"),
            "fusion.pnp:JointPnpEstimator", "#b35900", "P",
        ),
        Method(
            "mid-pnp", "Mid-Fusion, refined by the votes", 2, False,
            ("detector", "features", "volume"),
            "fusion.mid:MidFusionEstimator", "#8250df", "X", refine="votes",
        ),
        Method(
            "rgbd", "one view and a depth sensor", 1, True, ("detector", "features", "points"),
            "fusion.rgbd:RgbdEstimator", "#1b8a5a", "^",
        ),
    )
}  # fmt: skip
METHODS = tuple(METHOD_TABLE)

DEFAULT_METHOD = "mid-pnp"
"""The most accurate one of color images; that of the environments."""

SOLVERS = ("soft", "soft-mean", "kabsch", "hard")
"""Names of the solvers, from 3D keypoints to a pose; see ``solvers/rigid.py``."""

REFINEMENTS = ("none", "votes")
"""Ways to refine the pose of a method: by the votes of all views, or not."""


def check_refinement(refine: str) -> str:
    """Returns ``refine``.

    Raises:
        InputError: if it is not one of ``REFINEMENTS``.
    """
    if refine not in REFINEMENTS:
        raise InputError(f"refine must be {' or '.join(REFINEMENTS)}, got {refine!r}")
    return refine


def find_method(name: str) -> Method:
    """Returns the method of this name.

    Raises:
        InputError: if there is none.
    """
    if name not in METHOD_TABLE:
        raise InputError(f"unknown method {name!r}; there are {', '.join(METHODS)}")
    return METHOD_TABLE[name]
