"""The picture that ``render`` returns: both views, both poses, and the error before and after."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..assets.object_model import ObjectModel
from ..pose_estimator.geometry import transform
from ..pose_estimator.overlay import ESTIMATE_COLOUR, TRUE_COLOUR, draw_poses

_PANEL = (480, 640)  # height, width
_MARGIN, _GAP = 28, 24
_TOP, _BOTTOM = 118, 66  # space above and below the panels
_INSET = 172
_INK, _GREY, _GOOD = (28, 32, 38), (118, 124, 133), (27, 138, 58)
_PAPER, _EMPTY = (255, 255, 255), (241, 243, 245)


@dataclass(frozen=True, eq=False)
class Panel:
    """One view and what is drawn on it.

    Attributes:
        title: what the view is.
        note: a few words beside the title.
        image: RGB uint8, (H, W, 3).
        K: camera matrix of ``image``, (3, 3).
        T_cam_obj_true: true pose in this view's camera, (4, 4).
        T_cam_obj_estimate: estimated pose in this view's camera, (4, 4), or None.
        add: ADD(-S) of the estimate, metres, or None.
    """

    title: str
    note: str
    image: np.ndarray
    K: np.ndarray
    T_cam_obj_true: np.ndarray
    T_cam_obj_estimate: np.ndarray | None = None
    add: float | None = None

    def scaled(self, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """The picture and its camera matrix at another size (height, width)."""
        scale = np.array([shape[1] / self.image.shape[1], shape[0] / self.image.shape[0]])
        A = np.array(
            [
                [scale[0], 0.0, (scale[0] - 1) / 2],
                [0.0, scale[1], (scale[1] - 1) / 2],
                [0.0, 0.0, 1.0],
            ]
        )
        if (scale == 1).all():
            return self.image, self.K
        return cv2.resize(self.image, shape[::-1], interpolation=cv2.INTER_AREA), A @ self.K


def comparison(
    model: ObjectModel, subtitle: str, reference: Panel, second: Panel | None
) -> np.ndarray:
    """Reference and second view side by side, outlines drawn, ADD(-S) below each.

    Args:
        model: the target.
        subtitle: a few words beside its name.
        reference: the reference view with the pose from one view.
        second: the second view with the pose from both; None leaves its place empty.

    Returns:
        RGB uint8, (664, 1360, 3).
    """
    height, width = _PANEL
    canvas_size = (2 * _MARGIN + _GAP + 2 * width, _TOP + height + _BOTTOM)
    canvas = Image.new("RGB", canvas_size, _PAPER)
    draw = ImageDraw.Draw(canvas)
    end = _text(draw, (_MARGIN, 44), model.name, 32)
    _text(draw, (end + 16, 48), subtitle, 18, _GREY)
    _legend(draw, canvas_size[0] - _MARGIN, 44, reference.T_cam_obj_estimate is not None)
    for column, panel in enumerate((reference, second)):
        x = _MARGIN + column * (width + _GAP)
        if panel is None:
            _empty_panel(draw, x)
            continue
        end = _text(draw, (x, _TOP - 20), panel.title, 20)
        _text(draw, (end + 12, _TOP - 20), panel.note, 16, _GREY)
        canvas.paste(Image.fromarray(_panel_image(model, panel)), (x, _TOP))
        _score(draw, (x, _TOP + height + 34), model, panel.add)
    return np.asarray(canvas).copy()


def _panel_image(model: ObjectModel, panel: Panel) -> np.ndarray:
    """The view with both outlines and, in the emptiest corner, the object enlarged."""
    poses = {TRUE_COLOUR: panel.T_cam_obj_true}
    if panel.T_cam_obj_estimate is not None:
        poses[ESTIMATE_COLOUR] = panel.T_cam_obj_estimate
    image, K = panel.scaled(_PANEL)
    drawn = draw_poses(image, model, poses, K)
    points = transform(panel.T_cam_obj_true, model.vertices)
    points = points[points[:, 2] > 0.05]
    if not len(points):
        return drawn
    pixels = points @ K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    side = 1.45 * (high - low).max()
    if side > 1.5 * _INSET or (high < 0).any() or (low > (_PANEL[1], _PANEL[0])).any():
        return drawn  # large enough already, or out of the picture
    centre, scale = (low + high) / 2, _INSET / side
    A = np.array([[scale, 0.0, 0.0], [0.0, scale, 0.0], [0.0, 0.0, 1.0]])
    A[:2, 2] = (_INSET - 1) / 2 - scale * centre
    detail = cv2.warpAffine(
        image, A[:2], (_INSET, _INSET), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    detail = draw_poses(detail, model, poses, A @ K)
    pad, frame = 10, 2
    left = pad if centre[0] > _PANEL[1] / 2 else _PANEL[1] - _INSET - pad
    top = pad if centre[1] > _PANEL[0] / 2 else _PANEL[0] - _INSET - pad
    drawn[top - frame : top + _INSET + frame, left - frame : left + _INSET + frame] = 255
    drawn[top : top + _INSET, left : left + _INSET] = detail
    return drawn


def _empty_panel(draw: ImageDraw.ImageDraw, x: int) -> None:
    height, width = _PANEL
    draw.rectangle((x, _TOP, x + width - 1, _TOP + height - 1), fill=_EMPTY)
    _text(draw, (x, _TOP - 20), "Second view", 20, _GREY)
    middle = (x + width // 2, _TOP + height // 2)
    _text(draw, (middle[0], middle[1] - 16), "Not taken yet", 24, _GREY, "mm")
    message = "step(action) moves the camera and looks again"
    _text(draw, (middle[0], middle[1] + 18), message, 16, _GREY, "mm")


def _score(
    draw: ImageDraw.ImageDraw, at: tuple[int, int], model: ObjectModel, add: float | None
) -> None:
    """The error below a panel: in millimetres, then as a share of the diameter."""
    if add is None:
        _text(draw, at, "no estimate", 20, _GREY)
        return
    measure = "ADD-S" if model.symmetric else "ADD"
    end = _text(draw, at, f"{measure}  {1e3 * add:.1f} mm", 24)
    share = add / model.diameter
    verdict = "within" if share < 0.1 else "over"
    note = f"{100 * share:.1f} % of the diameter, {verdict} the limit of 10 %"
    _text(draw, (end + 16, at[1]), note, 18, _GOOD if share < 0.1 else _GREY)


def _legend(draw: ImageDraw.ImageDraw, right: int, y: int, estimated: bool) -> None:
    entries = [("true", TRUE_COLOUR), ("estimated", ESTIMATE_COLOUR)]
    for label, colour in reversed(entries[: 1 + estimated]):
        right -= int(_font(18).getlength(label))
        _text(draw, (right, y), label, 18)
        draw.line((right - 42, y, right - 12, y), fill=colour, width=4)
        right -= 72


def _text(
    draw: ImageDraw.ImageDraw,
    at: tuple[int, int],
    text: str,
    size: int,
    colour: tuple[int, int, int] = _INK,
    anchor: str = "lm",
) -> int:
    """Writes one line; returns where it ends (x)."""
    draw.text(at, text, fill=colour, font=_font(size), anchor=anchor)
    return at[0] + int(_font(size).getlength(text))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
