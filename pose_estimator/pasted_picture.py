"""One picture put together from objects that were cut out of others, with exact poses.

An object is moved in the picture as if the camera had turned about its own centre: whatever the
depth, every pixel then moves by the homography K' R K^-1, and the pose becomes R T_cam_obj. (To
shift pixels and keep the pose would be wrong: an object beside the axis is seen from elsewhere.)
Shading and the light's direction stay those of the source.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from .bop import BopAnnotation
from .bop_boxes import NO_BOX, bounding_box
from .bop_writer import BopFrame
from .cut_and_paste import blend
from .geometry import make_transform

LARGEST_ROLL = np.radians(25)
"""How far a moved object is turned about its line of sight at most."""


@dataclass(frozen=True, eq=False)
class CutOut:
    """An object and the picture that it is cut out of.

    Attributes:
        rgb: the picture, RGB uint8 (H, W, 3).
        mask: the object's visible pixels, bool (H, W).
        K: camera matrix of the picture, (3, 3).
        annotation: what the dataset says of the object.
    """

    rgb: np.ndarray
    mask: np.ndarray
    K: np.ndarray
    annotation: BopAnnotation


def turn_to(
    direction: np.ndarray, pixel: np.ndarray, K: np.ndarray, roll: float = 0.0
) -> np.ndarray:
    """The turn (3, 3) about the camera's centre that brings a direction to a pixel.

    Args:
        direction: (3,) in the camera's frame, of any length.
        pixel: (2,) where it shall be seen.
        K: camera matrix, (3, 3).
        roll: further turn about the new direction, radians.
    """
    start = direction / np.linalg.norm(direction)
    end = np.linalg.inv(K) @ [*pixel, 1.0]
    end /= np.linalg.norm(end)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, start @ end)
    shortest = Rotation.from_rotvec(axis * (angle / sine if sine > 1e-12 else 0.0))
    return (Rotation.from_rotvec(roll * end) * shortest).as_matrix()


def place_anywhere(
    cut: CutOut, K: np.ndarray, size: tuple[int, int], rng: np.random.Generator
) -> np.ndarray:
    """A random turn (3, 3) that brings an object's centre into a picture of ``size`` (H, W)."""
    height, width = size
    pixel = rng.uniform(0.1, 0.9, 2) * (width - 1, height - 1)
    roll = rng.uniform(-LARGEST_ROLL, LARGEST_ROLL)
    return turn_to(cut.annotation.T_cam_obj[:3, 3], pixel, K, roll)


def compose(
    canvas: np.ndarray,
    K: np.ndarray,
    shown: Sequence[tuple[BopAnnotation, np.ndarray]],
    pasted: Sequence[tuple[CutOut, np.ndarray]],
) -> BopFrame:
    """Pastes objects on a picture, the nearest last.

    Args:
        canvas: RGB uint8 (H, W, 3).
        K: its camera matrix, (3, 3).
        shown: annotations and visible masks, bool (H, W), of objects that the canvas shows itself.
            They count as farther than whatever is pasted.
        pasted: the objects, and how the camera turns about its centre for each, (3, 3).

    Returns:
        The picture with its annotations and masks: first those of ``shown``, then those of
        ``pasted`` from the farthest to the nearest. It has no world and no depth.
    """
    own = [mask.copy() for _, mask in shown]
    moved: list[tuple[BopAnnotation, np.ndarray]] = []
    # By distance, not by depth: a turn about the centre changes z.
    for cut, turn in sorted(pasted, key=_nearness):
        homography = K @ turn @ np.linalg.inv(cut.K)
        size = canvas.shape[1], canvas.shape[0]
        picture = cv2.warpPerspective(cut.rgb, homography, size, borderMode=cv2.BORDER_REPLICATE)
        alpha = cv2.warpPerspective(cut.mask.astype(np.uint8) * 255, homography, size)
        canvas = blend(canvas, picture, alpha)
        over = alpha > 127
        for mask in [*own, *(mask for _, mask in moved)]:
            mask &= ~over
        moved.append((_moved_annotation(cut, turn, homography), over))
    annotations = [
        _seen(annotation, mask, int(before.sum()) / max(annotation.visibility, 1e-6))
        for (annotation, before), mask in zip(shown, own, strict=True)
    ] + [_seen(annotation, mask, annotation.px_count_all) for annotation, mask in moved]
    return BopFrame(canvas, K, None, annotations, own + [mask for _, mask in moved])


def _nearness(item: tuple[CutOut, np.ndarray]) -> float:
    return -float(np.linalg.norm(item[0].annotation.T_cam_obj[:3, 3]))


def _moved_annotation(cut: CutOut, turn: np.ndarray, homography: np.ndarray) -> BopAnnotation:
    """The annotation with its new pose and silhouette; what of it is seen is left open.

    The silhouette's pixels are those of the visible mask, each as large as the homography makes
    it, over the share that was visible; its box is that of the visible pixels.
    """
    old = cut.annotation
    rows, columns = np.nonzero(cut.mask)
    u, v, w = homography @ np.stack([columns, rows, np.ones_like(rows)])
    area = float(np.sum(np.linalg.det(homography) / w**3)) / max(old.visibility, 1e-6)
    low = np.floor([(u / w).min() + 0.5, (v / w).min() + 0.5]).astype(int)
    high = np.floor([(u / w).max() + 0.5, (v / w).max() + 0.5]).astype(int)
    return replace(
        old,
        T_cam_obj=make_transform(turn, np.zeros(3)) @ old.T_cam_obj,
        bbox_obj=(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])),
        px_count_all=max(1, round(area)),
        bbox_visib=NO_BOX,
        px_count_visib=0,
    )


def _seen(annotation: BopAnnotation, mask: np.ndarray, silhouette: float) -> BopAnnotation:
    """The annotation of an object of whose ``silhouette`` (in pixels) ``mask`` (H, W) is seen."""
    count = int(mask.sum())
    return replace(
        annotation,
        visibility=min(1.0, count / max(silhouette, 1.0)),
        bbox_visib=bounding_box(mask),
        px_count_visib=count,
    )
