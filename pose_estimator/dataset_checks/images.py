"""Checks a sample of a scene's images, masks and depth maps, and that poses agree with them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...core.geometry import check_intrinsics
from ...core.images import read_image, read_mask, read_photograph
from ..bop.fields import MM, Place, rigid
from ..bop.scene import Scene
from .boxes import check_mask
from .coverage import Coverage
from .depth import DepthCheck
from .findings import Findings
from .meshes import CheckedModel
from .projection import FAIR, GOOD, MIN_PIXELS, MIN_VISIBLE, Projection
from .projection_score import Evidence

Decoded = TypeVar("Decoded")


@dataclass
class ImageCheck:
    """Checks images and accumulates wrong projections, which `projection.explain` explains.

    Attributes:
        models: obj_id -> model.
        camera_size: height and width of camera.json, or None.
        findings: receives the findings.
        depth: the comparison of the depth maps.
        suspects: projections with a low score.
        coverage: counts what was checked.
    """

    models: Mapping[int, CheckedModel]
    camera_size: tuple[int, int] | None
    findings: Findings
    depth: DepthCheck = field(default_factory=DepthCheck)
    suspects: list[Projection] = field(default_factory=list)
    coverage: Coverage = field(default_factory=Coverage)

    def check(self, scene: Scene, image_id: int, valid: np.ndarray) -> tuple[int, int]:
        """Checks one image; ``valid``, bool (N,), are the scene's annotations with a valid pose.

        Returns:
            Number of wrong projections, and number of projections compared.
        """
        image_path, place = scene.images[image_id], Place(scene.scene_id, image_id)
        opened = self._open(lambda file: read_photograph(file, upright=False), image_path, place)
        if opened is None:
            return 0, 0
        rgb, orientation = opened
        self.coverage.images += 1
        shape = (rgb.shape[0], rgb.shape[1])
        expected = self.camera_size
        if expected is not None and shape != expected:
            self.findings.warning(
                image_path, "size", "the image size differs from camera.json", place=place,
                detail=f"{shape[1]}x{shape[0]}, camera.json has {expected[1]}x{expected[0]}",
                cause="the images were scaled or cropped without the camera",
                remedy="scale cam_K like the images, and correct camera.json",
            )  # fmt: skip
        if orientation != 1:
            self.findings.warning(
                image_path, "orientation", "the image has an EXIF orientation", place=place,
                detail=f"orientation {orientation}",
                cause="a camera or phone wrote it; its stored pixels are used, as by masks and "
                "cam_K, but other programs turn it",
                remedy="remove the tag, such as with exiftool -Orientation=",
            )  # fmt: skip
        depth = self._depth(scene, image_id, shape, place)
        K = scene.K[scene.image_id == image_id][0]
        try:
            check_intrinsics(K)
        except ValueError:
            return 0, 0
        wrong = compared = 0
        for row in np.flatnonzero(scene.annotations.image_id == image_id).tolist():
            score = self._annotation(scene, row, shape, K, depth, bool(valid[row]))
            wrong += score is not None and score < FAIR
            compared += score is not None
        self.coverage.projections += compared
        return wrong, compared

    def _annotation(
        self,
        scene: Scene,
        row: int,
        shape: tuple[int, int],
        K: np.ndarray,
        depth: np.ndarray | None,
        valid: bool,
    ) -> float | None:
        """Checks one annotation's mask, projection and depth; returns the projection's score."""
        rows = scene.annotations
        place = scene.place(row)
        path = scene.mask_path(row)
        mask = None
        if path.is_file():
            mask = self._open(read_mask, path, place)
            if mask is None or not check_mask(scene, row, mask, shape, self.findings):
                return None
        model = self.models.get(int(rows.obj_id[row]))
        evidence = _evidence(scene, row, shape, mask)
        if not valid or model is None or not len(model.vertices) or evidence is None:
            return None
        T = rigid(rows.T_cam_obj[row : row + 1].copy())[0]
        projection = Projection(
            place=place,
            folder=scene.folder,
            mask_path=path,
            image_path=scene.images[int(rows.image_id[row])],
            model=model,
            T_cam_obj=T,
            K=K,
            evidence=evidence,
        )
        score = projection.evaluate()
        if score < GOOD:
            self.suspects.append(projection)
        if score >= FAIR and depth is not None and mask is not None:
            depth_path = scene.depths[int(rows.image_id[row])]
            self.depth.add(projection, depth_path, depth, mask)
        return score

    def _depth(
        self, scene: Scene, image_id: int, shape: tuple[int, int], place: Place
    ) -> np.ndarray | None:
        """Returns the depth map in meters, or None."""
        path = scene.depths.get(image_id)
        if path is None:
            return None
        steps = self._open(lambda file: read_image(file, None), path, place)
        if steps is None:
            return None
        if steps.ndim != 2 or steps.dtype.itemsize < 2:
            self.findings.error(
                path, "pixels", "the depth map is not 16-bit single-channel", place=place,
                detail=f"{steps.dtype} of shape {steps.shape}",
                cause="it was saved as a visualization",
                remedy="write depth as one channel of 16 bits",
            )  # fmt: skip
            return None
        if steps.shape != shape:
            self.findings.error(
                path, "size", "the depth map's size differs from the image's", place=place,
                detail=f"{steps.shape[1]}x{steps.shape[0]} for {shape[1]}x{shape[0]}",
                cause="it is not registered to the color camera",
                remedy="register depth to color",
            )  # fmt: skip
            return None
        steps = np.where(np.isfinite(steps), steps, 0)
        if not steps.any():
            self.findings.warning(
                path, "pixels", "the depth map is empty", place=place,
                remedy="remove it, or record it again",
            )  # fmt: skip
            return None
        return steps * (scene.depth_scale[scene.image_id == image_id][0] / MM)

    def _open(self, read: Callable[[Path], Decoded], path: Path, place: Place) -> Decoded | None:
        """Returns the decoded image file, or None with a finding."""
        try:
            return read(path)
        except (OSError, ValueError) as error:
            self.findings.error(
                path, "pixels", "cannot be read as an image", place=place,
                detail=str(error).removeprefix(f"{path} "),
                cause="truncated by a full disk or an interrupted download, or of an unusual kind",
                remedy="download or write it again",
            )  # fmt: skip
            return None


def _evidence(
    scene: Scene, row: int, shape: tuple[int, int], mask: np.ndarray | None
) -> Evidence | None:
    """Returns the mask or box to compare a projection with, or None if too little is visible."""
    rows = scene.annotations
    visible = float(rows.visibility[row])
    if visible < MIN_VISIBLE:
        return None
    if mask is not None:
        return Evidence.of_mask(mask, visible) if mask.sum() >= MIN_PIXELS else None
    for given, amodal in ((rows.bbox_obj[row], True), (rows.bbox_visib[row], False)):
        if not np.isnan(given).any() and (given[2:] > 0).all() and given[2:].prod() >= MIN_PIXELS:
            box = np.concatenate([given[:2], given[:2] + given[2:]])
            return Evidence(shape, box, None, visible, amodal)
    return None
