"""Where finished pictures go: into an array, or into a window."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slam_gym.rendering.canvas import pygame


class Window:
    """Takes pictures of `size` (width, height) [pixels].

    In `rgb_array` mode needs no display; in `human` mode keeps a window that follows the clock at `fps`.
    """

    def __init__(self, mode: Literal["rgb_array", "human"], size: tuple[int, int], title: str, fps: float) -> None:
        """Raises ValueError for an unknown mode."""
        if mode not in ("rgb_array", "human"):
            raise ValueError(f"unknown render mode {mode!r}; known: rgb_array, human")
        self.mode, self.size, self.title, self.fps = mode, size, title, fps
        self._window: Any = None
        self._clock: Any = None

    def show(self, picture: Any) -> NDArray[np.uint8] | None:
        """The picture (h, w, 3); None in `human` mode, where it goes to the window."""
        if self.mode == "rgb_array":
            width, height = self.size
            return np.frombuffer(pygame.image.tobytes(picture, "RGB"), np.uint8).reshape(height, width, 3).copy()
        if self._window is None:
            pygame.display.init()
            self._window = pygame.display.set_mode(self.size)
            pygame.display.set_caption(self.title)
            self._clock = pygame.time.Clock()
        self._window.blit(picture, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self.fps)
        return None

    def close(self) -> None:
        """Close the window, if there is one. May be called twice; showing again opens it anew."""
        if self._window is not None:
            pygame.display.quit()
            self._window = self._clock = None
