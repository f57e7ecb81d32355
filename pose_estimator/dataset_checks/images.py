"""Looks at a sample of a scene's images: what the files hold, and whether poses agree with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from ...core.geometry import check_intrinsics
from ...core.images import read_image
from ..bop.fields import MM, Place, rigid
from ..bop.scene import Scene
from .boxes import check_mask
from .cameras import check_size
from .depth import DepthCheck
from .findings import Findings
from .meshes import CheckedModel
from .projection import FAIR, GOOD, MIN_PIXELS, MIN_VISIBLE, Projection
from .projection_score import Evidence


@dataclass
class ImageCheck:
    """Looks at images, one after the other, and keeps what is to be explained in the end.

    Attributes:
        models: by number.
        camera_size: height and width that camera.json says, or None.
        findings: are added to.
        depth: what the depth maps said.
        suspects: projections that are not good.
        looked: how many images were looked at.
        projected: how many projections were compared.
        set_aside: how many scenes have so many wrong projections that nothing is compared with
            their poses.
    """

    models: Mapping[int, CheckedModel]
    camera_size: tuple[int, int] | None
    findings: Findings
    depth: DepthCheck = field(default_factory=DepthCheck)
    suspects: list[Projection] = field(default_factory=list)
    looked: int = 0
    projected: int = 0
    set_aside: int = 0

    def look(self, scene: Scene, image_id: int, whole: np.ndarray) -> tuple[int, int]:
        """Looks at one image.

        Args:
            scene: its scene.
            image_id: its number.
            whole: bool (N,), which annotations of the scene have a pose.

        Returns:
            How many projections were wrong, and how many were compared.
        """
        image_path, place = scene.images[image_id], Place(scene.scene_id, image_id)
        rgb = self._open(image_path, "RGB", place)
        if rgb is None:
            return 0, 0
        self.looked += 1
        shape = (rgb.shape[0], rgb.shape[1])
        check_size(image_path, shape, self.camera_size, place, self.findings)
        depth = self._depth(scene, image_id, shape, place)
        K = scene.K[scene.image_id == image_id][0]
        try:
            check_intrinsics(K)
        except ValueError:
            return 0, 0
        wrong = compared = 0
        for row in np.flatnonzero(scene.annotations.image_id == image_id).tolist():
            score = self._annotation(scene, row, image_path, shape, K, depth, bool(whole[row]))
            wrong += score is not None and score < FAIR
            compared += score is not None
        self.projected += compared
        return wrong, compared

    def _annotation(
        self,
        scene: Scene,
        row: int,
        image_path: Path,
        shape: tuple[int, int],
        K: np.ndarray,
        depth: np.ndarray | None,
        whole: bool,
    ) -> float | None:
        """Checks one annotation's mask, projection and depth; returns the projection's score."""
        rows = scene.annotations
        place = scene.place(row)
        path = scene.mask_path(row)
        mask = None
        if path.is_file():
            gray = self._open(path, "L", place)
            if gray is None:
                return None
            mask = gray > 0
            info = (rows.bbox_visib[row], rows.px_count_visib[row], rows.visibility[row])
            if not check_mask(path, mask, shape, scene.info_path, info, place, self.findings):
                return None
        model = self.models.get(int(rows.obj_id[row]))
        evidence = _evidence(scene, row, shape, mask)
        if not whole or model is None or not len(model.vertices) or evidence is None:
            return None
        T = rigid(rows.T_cam_obj[row : row + 1].copy())[0]
        projection = Projection(
            place=place,
            gt_path=scene.gt_path,
            camera_path=scene.camera_path,
            mask_path=path if mask is not None else None,
            image_path=image_path,
            model=model,
            T_cam_obj=T,
            K=K,
            evidence=evidence,
        )
        score = projection.look()
        if score < GOOD:
            self.suspects.append(projection)
        if score >= FAIR and depth is not None and mask is not None:
            depth_path = scene.depths[int(rows.image_id[row])]
            self.depth.add(scene.camera_path, depth_path, place, depth, mask, model, T)
        return score

    def _depth(
        self, scene: Scene, image_id: int, shape: tuple[int, int], place: Place
    ) -> np.ndarray | None:
        """The depth map in meters, or None."""
        path = scene.depths.get(image_id)
        if path is None:
            return None
        steps = self._open(path, None, place)
        if steps is None:
            return None
        if steps.ndim != 2 or steps.dtype.itemsize < 2:
            self.findings.error(
                path, "pixels", "a depth map is no map of 16 bits", place=place,
                detail=f"{steps.dtype} of shape {steps.shape}",
                cause="it was saved as an image for people to look at",
                remedy="write depth as one channel of 16 bits",
            )  # fmt: skip
            return None
        if steps.shape != shape:
            self.findings.error(
                path, "size", "a depth map has another size than its image", place=place,
                detail=f"{steps.shape[1]}x{steps.shape[0]} for {shape[1]}x{shape[0]}",
                cause="it is not registered to the color camera",
                remedy="register depth to color",
            )  # fmt: skip
            return None
        if not steps.any():
            self.findings.warning(
                path, "pixels", "a depth map is empty", place=place,
                remedy="remove it, or record it anew",
            )  # fmt: skip
            return None
        return steps * (scene.depth_scale[scene.image_id == image_id][0] / MM)

    def _open(
        self, path: Path, mode: Literal["RGB", "L"] | None, place: Place
    ) -> np.ndarray | None:
        """An image file, or None with a finding."""
        try:
            return read_image(path, mode)
        except (OSError, ValueError):
            self.findings.error(
                path, "pixels", "cannot be read as an image", place=place,
                detail=f"{path.stat().st_size} bytes" if path.exists() else "",
                cause="truncated by a full disk or a broken download",
                remedy="fetch or write it again",
            )  # fmt: skip
            return None


def _evidence(
    scene: Scene, row: int, shape: tuple[int, int], mask: np.ndarray | None
) -> Evidence | None:
    """What is known of where an object is, if it is enough to judge by."""
    rows = scene.annotations
    visible = float(rows.visibility[row])
    if visible < MIN_VISIBLE:
        return None
    if mask is not None:
        return Evidence.of_mask(mask, visible) if mask.sum() >= MIN_PIXELS else None
    for given, amodal in ((rows.bbox_obj[row], True), (rows.bbox_visib[row], False)):
        if not np.isnan(given).any() and (given[2:] > 0).all() and given[2] * given[3] >= 60:
            box = np.concatenate([given[:2], given[:2] + given[2:]])
            return Evidence(shape, box, None, visible, amodal)
    return None
