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
    """A window that shows one picture after the other, `fps` of them a second at most."""

    def __init__(self, title: str, fps: float) -> None:
        self.title, self.fps = title, fps
        self._window: Any = None
        self._clock: Any = None

    def show(self, picture: Any) -> None:
        """Show a surface; the window opens at the first one, in its size."""
        if self._window is None:
            pygame.display.init()
            self._window = pygame.display.set_mode(picture.get_size())
            pygame.display.set_caption(self.title)
            self._clock = pygame.time.Clock()
        self._window.blit(picture, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self.fps)

    def close(self) -> None:
        """Close the window, if it is open. May be called twice; showing again opens it anew."""
        if self._window is not None:
            pygame.display.quit()
            self._window = self._clock = None
