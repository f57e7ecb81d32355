"""Scores how well an object's projection matches its mask or box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.geometry import project, transform
from ..bop.boxes import bounding_box
from ..visualization import Shape, silhouette

_SIDE = 160
"""Pixels along the longer side of the window in which silhouettes are compared."""

_FINEST = 4.0
"""Maximum window pixels per image pixel: rasterized triangles are wider by half a window pixel."""

_LARGEST = 6.0
"""A projection longer than this multiple of the visible box scores 0."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The annotated mask or box of an object in an image.

    Attributes:
        shape: height and width of the image.
        box: left, top, right, bottom of the visible pixels.
        mask: bool (h, w) of the visible pixels within ``box``, or None where only boxes are known.
        visibility: visible fraction of the silhouette, NaN where unknown.
        amodal: whether ``box`` is that of the whole silhouette; only without a mask.
    """

    shape: tuple[int, int]
    box: np.ndarray
    mask: np.ndarray | None = None
    visibility: float = np.nan
    amodal: bool = False

    @classmethod
    def of_mask(cls, mask: np.ndarray, visibility: float) -> Evidence:
        """Returns the evidence of a non-empty mask (H, W), cropped to its box."""
        left, top, width, height = bounding_box(mask)
        part = mask[top : top + height + 1, left : left + width + 1].copy()
        box = np.array([left, top, left + width, top + height], dtype=float)
        return cls((mask.shape[0], mask.shape[1]), box, part, visibility)

    def score(self, model: Shape, T_cam_obj: np.ndarray, K: np.ndarray) -> float:
        """Returns how well a pose projects onto the evidence, from 0 (no overlap) to 1.

        With a mask: the intersection over union of mask and silhouette, divided by the visible
        fraction, which a correct pose reaches; where that is unknown, the share of the mask that
        the silhouette covers. Without a mask: the same for boxes. Pixels outside the image may
        count as visible or not: the better score is returned.

        Args:
            model: the object.
            T_cam_obj: its pose, (4, 4), rigid, meters.
            K: camera matrix, (3, 3).
        """
        vertices = transform(T_cam_obj, model.vertices)
        if len(vertices) == 0 or vertices[:, 2].min() <= 0.01:
            return 0.0
        pixels = project(vertices, K)
        box = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
        side = max(self.box[2:] - self.box[:2]) + 1
        if max(box[2:] - box[:2]) > _LARGEST * max(side, 8) or _overlap(box, self.box) <= 0:
            return 0.0
        if self.mask is None:
            return self._score_box(box)
        return self._score_mask(self.mask, model, T_cam_obj, K, box)

    def _score_box(self, box: np.ndarray) -> float:
        height, width = self.shape
        clipped = np.clip(box, 0, (width - 1, height - 1) * 2)
        if not self.amodal:
            return _overlap(box, self.box) / _area(self.box)
        return max(_overlap(b, self.box) / _union(b, self.box) for b in (box, clipped))

    def _score_mask(
        self, mask: np.ndarray, model: Shape, T: np.ndarray, K: np.ndarray, box: np.ndarray
    ) -> float:
        low = np.floor(np.minimum(box[:2], self.box[:2])) - 1
        high = np.ceil(np.maximum(box[2:], self.box[2:])) + 1
        scale = min(_FINEST, _SIDE / max(high - low + 1))
        across, down = (np.arange(n) for n in np.ceil((high - low + 1) * scale).astype(int))
        # Image pixels at the centers of the window's pixels.
        u = np.round(low[0] + across / scale).astype(int)
        v = np.round(low[1] + down / scale).astype(int)
        window = np.array([[scale, 0, -scale * low[0]], [0, scale, -scale * low[1]], [0, 0, 1]])
        covered = silhouette(model, T, window @ K, (len(v), len(u))) > 0
        inside = ((v >= 0) & (v < self.shape[0]))[:, None] & ((u >= 0) & (u < self.shape[1]))
        left, top, right, bottom = self.box.astype(int)
        boxed = ((v >= top) & (v <= bottom))[:, None] & ((u >= left) & (u <= right))
        rows, columns = np.clip(v - top, 0, bottom - top), np.clip(u - left, 0, right - left)
        seen = mask[np.ix_(rows, columns)] & boxed
        shared, visible = int((seen & covered).sum()), int(seen.sum())
        if not visible or not shared:
            return 0.0
        if not 0 < self.visibility <= 1:
            return shared / visible
        ratios = [
            shared / int((seen | part).sum()) / self.visibility
            for part in (covered, covered & inside)
        ]
        return max(min(ratio, 1 / ratio) for ratio in ratios)


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    width, height = np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]) + 1
    return float(max(width, 0) * max(height, 0))


def _area(box: np.ndarray) -> float:
    width, height = box[2:] - box[:2] + 1
    return float(width * height)


def _union(a: np.ndarray, b: np.ndarray) -> float:
    return _area(a) + _area(b) - _overlap(a, b)
