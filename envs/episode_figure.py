"""The figure that ``render`` returns: both views, both poses and their errors."""

from functools import cache

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..assets.object_model import ObjectModel
from ..core.geometry import crop_matrix, invert, project, transform
from ..pose_estimator.visualization import ESTIMATE_COLOR, TRUE_COLOR, draw_poses
from .episode import Episode

_PANEL = (480, 640)  # height, width
_MARGIN, _GAP = 28, 24
_TOP, _BOTTOM = 118, 66  # space above and below the panels
_INSET = 172
_TEXT, _GRAY, _GREEN = (28, 32, 38), (118, 124, 133), (27, 138, 58)
_BACKGROUND, _EMPTY = (255, 255, 255), (241, 243, 245)


def episode_figure(episode: Episode) -> np.ndarray:
    """Draws the first and the latest view with true and estimated outlines and ADD(-S).

    Returns:
        RGB uint8, (664, 1360, 3).
    """
    model = episode.model
    height, width = _PANEL
    canvas_size = (2 * _MARGIN + _GAP + 2 * width, _TOP + height + _BOTTOM)
    canvas = Image.new("RGB", canvas_size, _BACKGROUND)
    draw = ImageDraw.Draw(canvas)
    estimated = bool(episode.estimates)
    end = _text(draw, (_MARGIN, 44), model.name, 32)
    subtitle = f"{100 * episode.visibility:.0f} % visible in the reference view"
    _text(draw, (end + 16, 48), subtitle, 18, _GRAY)
    _legend(draw, canvas_size[0] - _MARGIN, 44, estimated)
    newest = len(episode.views) - 1
    motion = f"{episode.baseline_deg:.0f}° from the first, camera moved {episode.travel:.2f} m"
    titles = (
        ("Reference view", "pose from this view alone" if estimated else ""),
        ("Second view", motion),
    )
    for column, (title, note) in enumerate(titles):
        x, view = _MARGIN + column * (width + _GAP), column * newest
        if column > newest:
            _empty_panel(draw, x)
            continue
        end = _text(draw, (x, _TOP - 20), title, 20)
        _text(draw, (end + 12, _TOP - 20), note, 16, _GRAY)
        canvas.paste(Image.fromarray(_panel_image(episode, view)), (x, _TOP))
        _error_text(
            draw, (x, _TOP + height + 34), model, episode.errors[view] if estimated else None
        )
    return np.asarray(canvas).copy()


def _panel_image(episode: Episode, index: int) -> np.ndarray:
    """A view with both outlines and, in the corner opposite to the object, an enlarged inset."""
    model = episode.model
    T_cam_obj = episode.T_cam_obj_true(index)
    poses = {TRUE_COLOR: T_cam_obj}
    if episode.estimates:
        relative = episode.cameras[index] @ invert(episode.cameras[0])
        poses[ESTIMATE_COLOR] = relative @ episode.estimates[index].T_cam_obj
    image, K = _panel_sized(episode.views[index].image, episode.views[index].K)
    drawn = draw_poses(image, model, poses, K)
    points = transform(T_cam_obj, model.vertices)
    points = points[points[:, 2] > 0.05]
    if not len(points):
        return drawn
    pixels = project(points, K)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    side = 1.45 * (high - low).max()
    if side > 1.5 * _INSET or (high < 0).any() or (low > (_PANEL[1], _PANEL[0])).any():
        return drawn  # large enough, or outside the image
    center = (low + high) / 2
    A = crop_matrix(center, side, _INSET)
    detail = cv2.warpAffine(
        image, A[:2], (_INSET, _INSET), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    detail = draw_poses(detail, model, poses, A @ K)
    pad, frame = 10, 2
    left = pad if center[0] > _PANEL[1] / 2 else _PANEL[1] - _INSET - pad
    top = pad if center[1] > _PANEL[0] / 2 else _PANEL[0] - _INSET - pad
    drawn[top - frame : top + _INSET + frame, left - frame : left + _INSET + frame] = 255
    drawn[top : top + _INSET, left : left + _INSET] = detail
    return drawn


def _panel_sized(image: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Resizes an image (H, W, 3) and its camera matrix to a panel."""
    height, width = _PANEL
    if image.shape[:2] == _PANEL:
        return image, K
    x, y = width / image.shape[1], height / image.shape[0]
    A = np.array([[x, 0.0, (x - 1) / 2], [0.0, y, (y - 1) / 2], [0.0, 0.0, 1.0]])
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), A @ K


def _empty_panel(draw: ImageDraw.ImageDraw, x: int) -> None:
    height, width = _PANEL
    draw.rectangle((x, _TOP, x + width - 1, _TOP + height - 1), fill=_EMPTY)
    _text(draw, (x, _TOP - 20), "Second view", 20, _GRAY)
    middle = (x + width // 2, _TOP + height // 2)
    _text(draw, (middle[0], middle[1] - 16), "Not taken yet", 24, _GRAY, "mm")
    message = "step(action) moves the camera and takes it"
    _text(draw, (middle[0], middle[1] + 18), message, 16, _GRAY, "mm")


def _error_text(
    draw: ImageDraw.ImageDraw, at: tuple[int, int], model: ObjectModel, add: float | None
) -> None:
    """Writes the error below a panel, in millimeters and relative to the diameter."""
    if add is None:
        _text(draw, at, "no estimate", 20, _GRAY)
        return
    measure = "ADD-S" if model.symmetric else "ADD"
    end = _text(draw, at, f"{measure}  {1e3 * add:.1f} mm", 24)
    ratio = add / model.diameter
    verdict = "within" if ratio < 0.1 else "over"
    note = f"{100 * ratio:.1f} % of the diameter, {verdict} the limit of 10 %"
    _text(draw, (end + 16, at[1]), note, 18, _GREEN if ratio < 0.1 else _GRAY)


def _legend(draw: ImageDraw.ImageDraw, right: int, y: int, estimated: bool) -> None:
    entries = [("true", TRUE_COLOR), ("estimated", ESTIMATE_COLOR)]
    for label, color in reversed(entries[: 1 + estimated]):
        right -= int(_font(18).getlength(label))
        _text(draw, (right, y), label, 18)
        draw.line((right - 42, y, right - 12, y), fill=color, width=4)
        right -= 72


def _text(
    draw: ImageDraw.ImageDraw,
    at: tuple[int, int],
    text: str,
    size: int,
    color: tuple[int, int, int] = _TEXT,
    anchor: str = "lm",
) -> int:
    """Writes one line; returns the x where it ends."""
    draw.text(at, text, fill=color, font=_font(size), anchor=anchor)
    return at[0] + int(_font(size).getlength(text))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
