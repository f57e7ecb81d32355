"""What an image's annotations say of each object: boxes, visible fraction, mask and silhouette."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import project, transform
from ...pose_estimator.bop.boxes import NO_BOX, bounding_box
from ...pose_estimator.bop.dataset import BopAnnotation
from .renderer import Frame
from .scene import Scene


@dataclass(frozen=True, eq=False)
class FrameAnnotations:
    """What is known of one image; the lists are in the order of the frame's ``object_names``.

    Attributes:
        annotations: BOP's, of each object.
        masks: visible pixels, (H, W) bool each.
        silhouettes: all pixels that the object would cover with nothing before it, (H, W) bool
            each.
    """

    annotations: list[BopAnnotation]
    masks: list[np.ndarray]
    silhouettes: list[np.ndarray]


def annotate(
    scene: Scene, frame: Frame, T_cam_world: np.ndarray, K: np.ndarray
) -> FrameAnnotations:
    """Annotates an image, drawing the silhouette of each of its objects.

    Args:
        scene: as it stood when the image was rendered.
        frame: rendered with masks.
        T_cam_world: world to OpenCV camera, (4, 4), of the image.
        K: its camera matrix, (3, 3).

    Raises:
        InputError: if the frame has no masks.
    """
    if frame.instances is None:
        raise InputError("frame must have been rendered with masks=True")
    assert scene.state is not None
    known = FrameAnnotations([], [], [])
    for index, name in enumerate(frame.object_names):
        mask = frame.instances == index
        T_cam_obj = T_cam_world @ scene.state.T_world_obj[name]
        annotation, whole = _annotate(scene, name, mask, T_cam_world, T_cam_obj, K)
        known.annotations.append(annotation)
        known.masks.append(mask)
        known.silhouettes.append(whole)
    return known


def _annotate(
    scene: Scene,
    name: str,
    mask: np.ndarray,
    T_cam_world: np.ndarray,
    T_cam_obj: np.ndarray,
    K: np.ndarray,
) -> tuple[BopAnnotation, np.ndarray]:
    """An object's annotation, and its silhouette within the image, bool (H, W).

    The silhouette is drawn alone, in a window that also reaches beyond the image.
    """
    model = scene.objects[name]
    visible = int(np.count_nonzero(mask))
    left, top, width, height = silhouette_window(model, T_cam_obj, K, mask.shape)
    whole, box, inside = visible, bounding_box(mask), mask
    if width > 0 and height > 0:
        window_K = K - [[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]]
        geom = scene.world.geom(name)
        alone = scene.graphics.silhouette(geom, T_cam_world, window_K, height, width)
        x, y, *size = bounding_box(alone)
        box = NO_BOX if (x, y, *size) == NO_BOX else (x + left, y + top, size[0], size[1])
        whole = max(whole, int(np.count_nonzero(alone)))
        # The window lies within one image's size around the image.
        rows, columns = mask.shape
        around = np.zeros((3 * rows, 3 * columns), dtype=bool)
        around[rows + top : rows + top + height, columns + left : columns + left + width] = alone
        inside = mask | around[rows : 2 * rows, columns : 2 * columns]
    annotation = BopAnnotation(
        obj_id=model.obj_id,
        T_cam_obj=T_cam_obj,
        visibility=visible / whole if whole else 0.0,
        bbox_visib=bounding_box(mask),
        bbox_obj=box,
        px_count_visib=visible,
        px_count_all=whole,
    )
    return annotation, inside


def silhouette_window(
    model: ObjectModel, T_cam_obj: np.ndarray, K: np.ndarray, shape: tuple[int, ...]
) -> tuple[int, int, int, int]:
    """Left, top, width, height in pixels of a window that holds the object's silhouette.

    As in BOP, what is more than an image's width or height outside of the image is cut off.
    An object that reaches behind the camera gets the largest window.
    """
    height, width = shape
    limits = np.array([[-width, -height], [2 * width, 2 * height]])
    points = transform(T_cam_obj, model.vertices)
    if points[:, 2].max() <= 0.0:
        return 0, 0, 0, 0
    low, high = limits
    if points[:, 2].min() > 0.01:
        uv = project(points, K)
        low = np.clip(np.floor(uv.min(axis=0)) - 1, *limits).astype(int)
        high = np.clip(np.ceil(uv.max(axis=0)) + 2, *limits).astype(int)
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])
