"""What is known of the object's depth beside its keypoints, as a term of PnP's cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .pnp import PnpProblem

_LEAST_DEPTH = 1e-3


@dataclass(frozen=True)
class DepthPrior:
    """A guess of how far away the object's origin is.

    Attributes:
        depth: along the camera's z, m.
        deviation: standard deviation of its logarithm.
    """

    depth: float
    deviation: float


@dataclass(frozen=True, eq=False)
class WithDepths:
    """A PnP problem with a guess of the depth in each view.

    The views show one object to one network, so their guesses err alike: together they count as
    much as one.

    Attributes:
        problem: without the guesses.
        priors: of V views.
        T_view_first: (V, 4, 4), from the camera in which the pose is sought.
    """

    problem: PnpProblem
    priors: Sequence[DepthPrior]
    T_view_first: np.ndarray

    def _terms(self, translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depths (V,) of the origin in the views, and their errors in standard deviations."""
        depth = self.T_view_first[:, 2, :3] @ translation + self.T_view_first[:, 2, 3]
        depth = np.maximum(depth, _LEAST_DEPTH)
        guess = np.array([prior.depth for prior in self.priors])
        deviation = np.array([prior.deviation for prior in self.priors])
        return depth, np.log(depth / guess) / (deviation * np.sqrt(len(guess)))

    def cost(self, rotation: np.ndarray, translation: np.ndarray) -> float:
        """The problem's cost and half the squared errors."""
        cost = self.problem.cost(rotation, translation)
        if not np.isfinite(cost):
            return cost
        return cost + 0.5 * float((self._terms(translation)[1] ** 2).sum())

    def normal_equations(
        self, rotation: np.ndarray, translation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (6,) and Gauss-Newton matrix (6, 6) of the cost."""
        gradient, information = self.problem.normal_equations(rotation, translation)
        depth, errors = self._terms(translation)
        deviation = np.array([prior.deviation for prior in self.priors]) * np.sqrt(len(depth))
        jacobian = np.zeros((len(depth), 6))
        jacobian[:, 3:] = self.T_view_first[:, 2, :3] / (depth * deviation)[:, None]
        return gradient + jacobian.T @ errors, information + jacobian.T @ jacobian
