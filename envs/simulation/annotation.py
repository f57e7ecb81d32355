"""Ground-truth annotations of an image: boxes, visible fractions, masks and silhouettes."""

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
    """Annotations of one image, in the order of the frame's ``object_names``.

    Attributes:
        annotations: of each object, as in BOP.
        masks: visible pixels (``mask_visib`` of BOP), (H, W) bool each.
        silhouettes: pixels of the unoccluded object (``mask`` of BOP), (H, W) bool each.
    """

    annotations: list[BopAnnotation]
    masks: list[np.ndarray]
    silhouettes: list[np.ndarray]


def annotate(
    scene: Scene, frame: Frame, T_cam_world: np.ndarray, K: np.ndarray
) -> FrameAnnotations:
    """Annotates an image, rendering the silhouette of each of its objects.

    Args:
        scene: unchanged since the image was rendered.
        frame: rendered with masks.
        T_cam_world: world to OpenCV camera, (4, 4).
        K: camera matrix, (3, 3).

    Raises:
        InputError: if the frame has no masks.
    """
    if frame.instances is None:
        raise InputError("frame must have been rendered with masks=True")
    result = FrameAnnotations([], [], [])
    for index, name in enumerate(frame.object_names):
        mask = frame.instances == index
        annotation, silhouette = _annotate(scene, name, mask, T_cam_world, K)
        result.annotations.append(annotation)
        result.masks.append(mask)
        result.silhouettes.append(silhouette)
    return result


def _annotate(
    scene: Scene, name: str, mask: np.ndarray, T_cam_world: np.ndarray, K: np.ndarray
) -> tuple[BopAnnotation, np.ndarray]:
    """Returns an object's annotation, and its silhouette within the image, bool (H, W).

    The object is rendered alone, in a window that may extend beyond the image.
    """
    assert scene.state is not None
    T_cam_obj = T_cam_world @ scene.state.T_world_obj[name]
    model = scene.objects[name]
    visible = int(np.count_nonzero(mask))
    left, top, width, height = silhouette_window(model, T_cam_obj, K, mask.shape)
    total, box, silhouette = visible, bounding_box(mask), mask
    if width > 0 and height > 0:
        window_K = K - [[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]]
        geom = scene.world.geom(name)
        alone = scene.graphics.silhouette(geom, T_cam_world, window_K, height, width)
        x, y, *size = bounding_box(alone)
        box = NO_BOX if (x, y, *size) == NO_BOX else (x + left, y + top, size[0], size[1])
        total = max(total, int(np.count_nonzero(alone)))
        # The window extends at most one image size beyond the image on each side.
        rows, columns = mask.shape
        padded = np.zeros((3 * rows, 3 * columns), dtype=bool)
        padded[rows + top : rows + top + height, columns + left : columns + left + width] = alone
        silhouette = mask | padded[rows : 2 * rows, columns : 2 * columns]
    annotation = BopAnnotation(
        obj_id=model.obj_id,
        T_cam_obj=T_cam_obj,
        visibility=visible / total if total else 0.0,
        bbox_visib=bounding_box(mask),
        bbox_obj=box,
        px_count_visib=visible,
        px_count_all=total,
    )
    return annotation, silhouette


def silhouette_window(
    model: ObjectModel, T_cam_obj: np.ndarray, K: np.ndarray, shape: tuple[int, ...]
) -> tuple[int, int, int, int]:
    """Returns left, top, width, height in pixels of a window that contains the silhouette.

    As in BOP, it is clipped one image size beyond the image on each side. An object that extends
    behind the camera gets the largest window.
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
