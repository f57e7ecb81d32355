"""Do depth maps say the same distance as the poses."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...core.geometry import transform
from ..bop.fields import Place
from .findings import Findings
from .meshes import CheckedModel

STEPS = (1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3)
"""Factors by which a wrong depth_scale is usually wrong."""

MIN_PIXELS = 40


@dataclass
class DepthCheck:
    """Compares the median depth in each mask with the distances of the object's surface.

    Attributes:
        measured: how many annotations were measured.
        wrong: those that disagree: scene_camera.json, the depth map, the place, the factor by which
            the depth is wrong, and the distances in words.
    """

    measured: int = 0
    wrong: list[tuple[Path, Path, Place, float, str]] = field(default_factory=list)

    def add(
        self, camera_path: Path, depth_path: Path, place: Place, depth: np.ndarray,
        mask: np.ndarray, model: CheckedModel, T_cam_obj: np.ndarray,
    ) -> None:  # fmt: skip
        """Measures one annotation.

        Args:
            camera_path: scene_camera.json.
            depth_path: the depth map.
            place: of the annotation.
            depth: (H, W) meters, 0 where there is none.
            mask: bool (H, W) of the visible pixels.
            model: the object.
            T_cam_obj: its pose, (4, 4), meters, which projects onto the mask.
        """
        seen = depth[mask & (depth > 0)]
        if len(seen) < MIN_PIXELS:
            return
        self.measured += 1
        median, z = float(np.median(seen)), transform(T_cam_obj, model.vertices)[:, 2]
        slack = 0.02 + 0.15 * model.measured
        if not z.min() - slack <= median <= z.max() + slack:
            ratio = median / ((z.min() + z.max()) / 2)
            detail = (
                f"object {model.obj_id}: depth {1e3 * median:.4g} mm, pose "
                f"{1e3 * z.min():.4g} to {1e3 * z.max():.4g} mm"
            )
            self.wrong.append((camera_path, depth_path, place, ratio, detail))

    def report(self, findings: Findings) -> None:
        """Adds what was found; errors where most annotations disagree, else warnings."""
        problem = "depth maps disagree with the poses"
        add = findings.error if 2 * len(self.wrong) > self.measured else findings.warning
        for camera_path, depth_path, place, ratio, detail in self.wrong:
            factor = next((s for s in STEPS if 0.8 < ratio / s < 1.25), None)
            if factor is not None:
                way = f"divide depth_scale by {factor:g}"
                if factor < 1:
                    way = f"multiply depth_scale by {1 / factor:g}"
                findings.error(
                    camera_path, "depth_scale", problem, place=place, detail=detail,
                    cause=f"depth_scale is {factor:g} times what it must be",
                    remedy=f"{way}: it is the millimeters of one step",
                )  # fmt: skip
                continue
            add(
                depth_path, "pixels", problem, place=place, detail=detail,
                cause="the map is another image's, is not aligned with the color camera, or "
                "something hides the object that its mask does not know",
                remedy="register depth to color, and check that files belong together",
            )  # fmt: skip
