"""Where finished pictures go: into an array, or into a window."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_gym.rendering.canvas import pygame


def pixels(picture: Any) -> NDArray[np.uint8]:
    """A surface as a fresh array (h, w, 3)."""
    width, height = picture.get_size()
    return np.frombuffer(pygame.image.tobytes(picture, "RGB"), np.uint8).reshape(height, width, 3).copy()


class Window:
    """A window that shows one picture after the other, `fps` of them a second at most.

    Of a `resizable` one the user chooses the size, and pictures are scaled to it.
    """

    def __init__(self, title: str, fps: float, resizable: bool = False) -> None:
        self.title, self.fps, self.resizable = title, fps, resizable
        self._window: Any = None
        self._clock: Any = None

    def show(self, picture: Any) -> None:
        """Show a surface; the window opens at the first one, in its size."""
        if self._window is None:
            pygame.display.init()
            self._window = pygame.display.set_mode(picture.get_size(), pygame.RESIZABLE if self.resizable else 0)
            pygame.display.set_caption(self.title)
            self._clock = pygame.time.Clock()
        size = self._window.get_size()
        fitting = picture if not self.resizable or size == picture.get_size() else _fitted(picture, size)
        self._window.blit(fitting, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self.fps)

    @property
    def is_visible(self) -> bool:
        """Whether there is a display for it to appear on."""
        return pygame.display.get_driver() not in ("dummy", "offscreen")

    def close(self) -> None:
        """Close the window, if it is open. May be called twice; showing again opens it anew."""
        if self._window is not None:
            pygame.display.quit()
            self._window = self._clock = None


def _fitted(picture: Any, size: tuple[int, int]) -> Any:
    """The picture as large as it fits into `size`, in its own proportions, on a dark ground."""
    width, height = picture.get_size()
    scale = min(size[0] / width, size[1] / height)
    scaled = pygame.transform.smoothscale(picture, (max(1, round(width * scale)), max(1, round(height * scale))))
    ground = pygame.Surface(size, depth=32)
    ground.blit(scaled, ((size[0] - scaled.get_width()) // 2, (size[1] - scaled.get_height()) // 2))
    return ground
