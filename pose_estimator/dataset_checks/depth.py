"""Checks that depth maps agree with the poses."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...core.geometry import transform
from .findings import Findings
from .projection import Projection

STEPS = (1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3)
"""Common factors of a wrong depth_scale."""

MIN_PIXELS = 40


@dataclass
class DepthCheck:
    """Compares the median depth in each mask with the depth range of the object's surface.

    Attributes:
        measured: number of annotations measured.
        wrong: those that disagree: projection, depth map, ratio of the depths, and detail.
    """

    measured: int = 0
    wrong: list[tuple[Projection, Path, float, str]] = field(default_factory=list)

    def add(
        self, projection: Projection, depth_path: Path, depth: np.ndarray, mask: np.ndarray
    ) -> None:
        """Measures an annotation that projects onto its visible ``mask``, bool (H, W).

        ``depth`` is (H, W) in meters, 0 where unknown.
        """
        values = depth[mask & (depth > 0)]
        if len(values) < MIN_PIXELS:
            return
        self.measured += 1
        model = projection.model
        median, z = float(np.median(values)), transform(projection.T_cam_obj, model.vertices)[:, 2]
        slack = 0.02 + 0.15 * model.measured
        if not z.min() - slack <= median <= z.max() + slack:
            ratio = median / ((z.min() + z.max()) / 2)
            surface = f"{1e3 * z.min():.4g} to {1e3 * z.max():.4g} mm"
            detail = f"object {model.obj_id}: depth {1e3 * median:.4g} mm, pose {surface}"
            self.wrong.append((projection, depth_path, ratio, detail))

    def report(self, findings: Findings) -> None:
        """Adds the findings: errors where most annotations disagree, else warnings."""
        problem = "the depth map disagrees with the poses"
        add = findings.error if 2 * len(self.wrong) > self.measured else findings.warning
        for projection, depth_path, ratio, detail in self.wrong:
            factor = next((s for s in STEPS if 0.8 < ratio / s < 1.25), None)
            if factor is not None:
                findings.error(
                    projection.folder / "scene_camera.json", "depth_scale", problem,
                    place=projection.place, detail=detail,
                    cause=f"depth_scale is {factor:g} times the correct value",
                    remedy=f"divide depth_scale by {factor:g}: it is the millimeters per unit",
                )  # fmt: skip
                continue
            add(
                depth_path, "pixels", problem, place=projection.place, detail=detail,
                cause="it is of another image, is not registered to the color camera, or the mask "
                "ignores an occluder",
                remedy="register depth to color, and check that files match",
            )  # fmt: skip
