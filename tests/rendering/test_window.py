"""Finished pictures: fresh arrays, and a window that opens and closes as often as it likes."""

import numpy as np
import pytest

pytest.importorskip("pygame")

from slam_gym.rendering.canvas import pygame
from slam_gym.rendering.window import Window, pixels


def test_pixels_are_a_fresh_array_with_rows_first() -> None:
    surface = pygame.Surface((30, 20), depth=32)
    surface.fill((1, 2, 3))
    surface.set_at((29, 0), (9, 8, 7))
    array = pixels(surface)
    assert array.shape == (20, 30, 3) and array.dtype == np.uint8 and array.flags.writeable
    assert tuple(array[0, 29]) == (9, 8, 7) and tuple(array[19, 0]) == (1, 2, 3)
    assert not np.shares_memory(array, pixels(surface))


def test_a_window_opens_closes_and_opens_again() -> None:
    window, surface = Window("test", fps=1000.0), pygame.Surface((30, 20), depth=32)
    window.close()
    for _ in range(2):
        window.show(surface)
        window.show(surface)
        assert pygame.display.get_surface().get_size() == (30, 20)
        window.close()
        window.close()
        assert not pygame.display.get_init()


def test_a_picture_is_scaled_to_a_resizable_window_in_its_proportions() -> None:
    window, surface = Window("test", fps=1000.0, resizable=True), pygame.Surface((30, 20), depth=32)
    surface.fill((255, 0, 0))
    window.show(surface)
    window._window = pygame.display.set_mode((120, 40), pygame.RESIZABLE)  # as if the user had drawn at its corner
    window.show(surface)
    shown = pixels(pygame.display.get_surface())
    assert tuple(shown[20, 60]) == (255, 0, 0) and tuple(shown[20, 10]) == tuple(shown[20, 110]) == (0, 0, 0)
    assert not window.is_visible  # on the display of the tests
    window.close()
