"""Checks that objects project onto their masks, and explains those that do not."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...core.geometry import project, transform
from ..bop.fields import Place
from ..bop.pose_mistakes import Correction, corrections
from .findings import Findings
from .meshes import CheckedModel
from .projection_score import Evidence

GOOD, FAIR, POOR = 0.88, 0.7, 0.5
"""Values of `Evidence.score`: below GOOD corrections are tried, below FAIR it is a finding, below
POOR an error even without a known cause."""

EXPLAINS = 0.8
"""Score from which on another reading of a pose explains it."""

GAIN = 0.15
"""Minimum gain in score of another reading over the pose as written."""

SHARE = 0.3
"""Share of a dataset's wrong projections that a cause must explain to be named at all."""

SHIFTED = "shifted"
MIN_SHIFTED = 3
"""A single projection beside its mask is a wrong translation; several are shifted masks."""

MIN_PIXELS = 60
MIN_VISIBLE = 0.15
"""Objects with fewer visible pixels, or a smaller visible fraction, are not compared."""


@dataclass(eq=False)
class Projection:
    """An annotation and the score of its projection.

    Attributes:
        folder: its scene's folder.
        mask_path: its mask, which may not exist.
        T_cam_obj: as written, (4, 4), orthonormal.
        K: as written, (3, 3).
        evidence: what it should cover.
        score: of the pose as written.
        readings: other readings that explain it, with their scores.
        cause: the correction that was chosen.
    """

    place: Place
    folder: Path
    mask_path: Path
    image_path: Path
    model: CheckedModel
    T_cam_obj: np.ndarray
    K: np.ndarray
    evidence: Evidence
    score: float = 0.0
    readings: list[tuple[Correction, float]] = field(default_factory=list)
    cause: Correction | None = None

    def evaluate(self) -> float:
        """Scores the pose as written and, where that is low, every correction of it."""
        self.score = self.evidence.score(self.model, self.T_cam_obj, self.K)
        if self.score < GOOD:
            readings = [*corrections(self.T_cam_obj, self.K, self.evidence.shape), *self._shifted()]
            for reading in readings:
                score = self.evidence.score(self.model, reading.T_cam_obj, reading.K)
                if score >= max(EXPLAINS, self.score + GAIN):
                    self.readings.append((reading, score))
        return self.score

    def _shifted(self) -> list[Correction]:
        """Returns a correction that shifts the projection onto its mask, if enough is visible."""
        visible = self.evidence.visibility
        if np.isfinite(visible) and visible < 0.8:
            return []
        points = transform(self.T_cam_obj, self.model.vertices)
        if not len(points) or points[:, 2].min() <= 0.01:
            return []
        pixels = project(points, self.K)
        box = self.evidence.box
        shift = (box[:2] + box[2:]) / 2 - (pixels.min(axis=0) + pixels.max(axis=0)) / 2
        K = self.K.copy()
        K[:2, 2] += shift
        named = "pixels" if self.evidence.mask is not None else "bbox_visib"
        return [
            Correction(
                SHIFTED, named, "the shape is right and its place is not: masks were shifted or "
                "cropped, or cx and cy are of another crop",
                "draw masks from the same images, or correct cx and cy", self.T_cam_obj, K,
            )
        ]  # fmt: skip


def explain(suspects: Sequence[Projection]) -> list[Projection]:
    """Chooses a cause for each wrong projection; returns the wrong ones.

    One dataset is written by one program, so the cause that explains most of its wrong projections
    is preferred in each. Projections that are merely not good are wrong if that cause explains them
    much better.
    """
    wrong = [p for p in suspects if p.score < FAIR]
    support = Counter(reading.name for p in wrong for reading, _ in p.readings)
    accepted = {name for name, count in support.items() if count >= SHARE * len(wrong)}
    if support[SHIFTED] < MIN_SHIFTED:
        accepted.discard(SHIFTED)
    for projection in suspects:
        known = [(r, s) for r, s in projection.readings if r.name in accepted]
        if known:
            best = max(score for _, score in known)
            near = [reading for reading, score in known if score >= best - 0.1]
            projection.cause = max(near, key=lambda reading: support[reading.name])
    return [p for p in suspects if p.score < FAIR or p.cause is not None]


def report(wrong: Sequence[Projection], findings: Findings) -> None:
    """Adds a finding for each wrong projection."""
    for projection in wrong:
        target = "box" if projection.evidence.mask is None else "mask"
        problem = f"the object does not project onto its {target}"
        cause, folder = projection.cause, projection.folder
        name = cause.field if cause else "cam_R_m2c, cam_t_m2c"
        files = {"cam_K": folder / "scene_camera.json", "pixels": projection.mask_path}
        files["bbox_visib"] = folder / "scene_gt_info.json"
        file = files.get(name, folder / "scene_gt.json")
        add = findings.error if cause is not None or projection.score < POOR else findings.warning
        detail = f"object {projection.model.obj_id} matches to {100 * projection.score:.0f} %"
        if cause is not None:
            better = next(s for r, s in projection.readings if r is cause)
            detail += f", to {100 * better:.0f} % when corrected"
        add(
            file, name, problem, place=projection.place, detail=detail,
            cause=cause.cause if cause else "pose, mask, camera or model are another's",
            remedy=cause.remedy if cause else "see the overlay (--out DIR) and annotate again",
        )  # fmt: skip
