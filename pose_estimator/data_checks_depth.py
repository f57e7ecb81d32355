"""Do depth maps say the same distance as the poses."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .bop_fields import Place
from .data_findings import Findings
from .data_models import CheckedModel
from .geometry import transform

STEPS = (1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3)
"""Factors by which a wrong depth_scale is usually wrong."""

LEAST_PIXELS = 40


@dataclass(frozen=True)
class _Measured:
    camera_path: Path
    depth_path: Path
    place: Place
    obj_id: int
    depth: float
    nearest: float
    farthest: float
    slack: float

    @property
    def off(self) -> bool:
        return not self.nearest - self.slack <= self.depth <= self.farthest + self.slack

    @property
    def ratio(self) -> float:
        return self.depth / ((self.nearest + self.farthest) / 2)


@dataclass
class DepthCheck:
    """Compares the median depth in each mask with the distances of the object's surface."""

    _measured: list[_Measured] = field(default_factory=list)

    def add(
        self,
        paths: tuple[Path, Path],
        place: Place,
        depth: np.ndarray,
        mask: np.ndarray,
        model: CheckedModel,
        T_cam_obj: np.ndarray,
    ) -> None:
        """Measures one annotation.

        Args:
            paths: scene_camera.json and the depth map.
            place: of the annotation.
            depth: (H, W) metres, 0 where there is none.
            mask: bool (H, W) of the visible pixels.
            model: the object.
            T_cam_obj: its pose, (4, 4), metres, which projects onto the mask.
        """
        seen = depth[mask & (depth > 0)]
        if len(seen) < LEAST_PIXELS:
            return
        z = transform(T_cam_obj, model.vertices)[:, 2]
        slack = 0.02 + 0.15 * model.measured
        self._measured.append(
            _Measured(
                *paths, place, model.obj_id, float(np.median(seen)), z.min(), z.max(), slack
            )
        )  # fmt: skip

    def report(self, findings: Findings) -> None:
        """Adds what was found; errors where most annotations disagree, else warnings."""
        wrong = [m for m in self._measured if m.off]
        most = 2 * len(wrong) > len(self._measured)
        for m in wrong:
            factor = next((s for s in STEPS if 0.8 < m.ratio / s < 1.25), None)
            detail = (
                f"object {m.obj_id}: depth {1e3 * m.depth:.4g} mm, pose "
                f"{1e3 * m.nearest:.4g} to {1e3 * m.farthest:.4g} mm"
            )
            if factor is not None:
                way = f"divide depth_scale by {factor:g}"
                if factor < 1:
                    way = f"multiply depth_scale by {1 / factor:g}"
                findings.error(
                    m.camera_path, "depth_scale", "depth maps disagree with the poses",
                    place=m.place, detail=detail,
                    cause=f"depth_scale is {factor:g} times what it must be",
                    remedy=f"{way}: it is the millimetres of one step",
                )  # fmt: skip
                continue
            add = findings.error if most else findings.warning
            add(
                m.depth_path, "pixels", "depth maps disagree with the poses", place=m.place,
                detail=detail,
                cause="the map is another picture's, is not aligned with the colour camera, or "
                "something hides the object that its mask does not know",
                remedy="register depth to colour, and check that files belong together",
            )  # fmt: skip
