"""``render_mode="human"``: shows frames in a window, or as an image file without one."""

import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..core.files import write_atomically


class Window:
    """A pygame window; without pygame or a display, a PNG file that each frame replaces.

    Attributes:
        file: the PNG file, printed once to stderr; None if there is a window or no frame yet.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._pygame: Any = None
        self.file: Path | None = None

    def show(self, frame: np.ndarray) -> None:
        """Shows an RGB uint8 frame (H, W, 3)."""
        if self._pygame is None and self.file is None:
            self._open(frame.shape[1], frame.shape[0])
        if self.file is not None:
            write_atomically(self.file, cv2.imencode(".png", frame[..., ::-1])[1].tobytes())
            return
        surface = self._pygame.display.get_surface()
        self._pygame.surfarray.blit_array(surface, frame.swapaxes(0, 1))
        self._pygame.event.pump()
        self._pygame.display.flip()

    def __deepcopy__(self, memo: dict[int, Any]) -> "Window":
        return Window(self._title)

    def close(self) -> None:
        """Closes the window; can be called again."""
        if self._pygame is not None:
            self._pygame.display.quit()
        self._pygame = self.file = None

    def _open(self, width: int, height: int) -> None:
        try:
            import pygame

            pygame.display.init()
            pygame.display.set_mode((width, height))
            pygame.display.set_caption(self._title)
        except (ImportError, RuntimeError) as error:  # pygame's own error is a RuntimeError
            missing = f"pygame found no display: {error}"
            if isinstance(error, ImportError):
                missing = "pygame is not installed; run `pip install pygame-ce`"
            self.file = Path(tempfile.mkdtemp(prefix="two_view_pose_")) / "frame.png"
            print(f"No window ({missing}): frames go to {self.file}", file=sys.stderr)
        else:
            self._pygame = pygame
