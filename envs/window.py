"""Shows frames to a person: in a window where there is one, else as a picture file."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from types import ModuleType

import numpy as np
from PIL import Image


class Window:
    """What ``render_mode="human"`` draws on.

    With pygame and a display it is a window. Without, every frame replaces one PNG file, whose
    place is printed once to stderr together with what is missing.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._pygame: ModuleType | None = None
        self._file: Path | None = None
        self._open = False

    @property
    def file(self) -> Path | None:
        """The picture file that stands in for a window; None if there is a window."""
        return self._file

    def show(self, frame: np.ndarray) -> None:
        """Shows an RGB uint8 frame (H, W, 3)."""
        if not self._open:
            self._open = True
            missing = self._open_window(frame.shape[1], frame.shape[0])
            if missing:
                folder = Path(tempfile.mkdtemp(prefix="two_view_pose_"))
                self._file = folder / "frame.png"
                print(f"No window ({missing}): frames go to {self._file}", file=sys.stderr)
        if self._file is not None:
            scratch = self._file.with_suffix(".tmp.png")
            Image.fromarray(frame).save(scratch, compress_level=1)
            scratch.replace(self._file)
        elif self._pygame is not None:
            surface = self._pygame.surfarray.make_surface(frame.swapaxes(0, 1))
            self._pygame.display.get_surface().blit(surface, (0, 0))
            self._pygame.event.pump()
            self._pygame.display.flip()

    def close(self) -> None:
        """Closes the window; may be called again."""
        if self._pygame is not None:
            self._pygame.display.quit()
        self._pygame, self._file, self._open = None, None, False

    def _open_window(self, width: int, height: int) -> str:
        """Opens the window; returns what is missing, or nothing if it is open."""
        try:
            import pygame
        except ImportError:
            return "pip install pygame-ce opens one"
        try:
            pygame.display.init()
            pygame.display.set_mode((width, height))
        except pygame.error as error:
            pygame.display.quit()
            return f"pygame found no display: {error}"
        pygame.display.set_caption(self._title)
        self._pygame = pygame
        return ""
