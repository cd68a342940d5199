"""A canvas in metres: ellipses hold what they say, cells lie where they are put, nothing overflows."""

import os
import subprocess
import sys

import numpy as np
import pytest

from slam_gym.geometry import transform
from slam_gym.rendering.canvas import SUPERSAMPLING, Canvas, Window, pixels, pygame

pytest.importorskip("pygame")

WHITE, BLACK = (255, 255, 255), (0, 0, 0)


def painted(canvas) -> np.ndarray:
    """(w, h) of the supersampled surface, y down."""
    return pygame.surfarray.array3d(canvas.surface)[:, :, 0] == 0


def test_ellipses_hold_95_percent() -> None:
    rng = np.random.default_rng(2)
    covariance = np.array([[1.0, 0.6], [0.6, 0.8]])
    canvas = Canvas((800, 800), (-8.0, -8.0), 50.0, WHITE)
    canvas.ellipses(np.array([[0.5, -0.5]]), covariance[None], BLACK, None)
    samples = rng.multivariate_normal([0.5, -0.5], covariance, 20_000)
    x, y = ((samples + 8.0) * 50.0 * SUPERSAMPLING).astype(int).T
    assert 0.94 < painted(canvas)[x, 800 * SUPERSAMPLING - 1 - y].mean() < 0.96


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.5])
def test_cells_lie_where_their_corner_puts_them(heading) -> None:
    corner, codes = np.array([5.0, 4.0, heading]), np.random.default_rng(1).integers(0, 3, (4, 6)).astype(np.uint8)
    colours = [(10, 0, 0), (20, 0, 0), (30, 0, 0)]
    canvas = Canvas((400, 400), (0.0, 0.0), 40.0, WHITE)
    canvas.cells(codes, colours, corner, 0.5)
    picture = pixels(canvas.picture())
    for row in range(4):
        for column in range(6):
            x, y = transform(corner, 0.5 * (np.array([[column, row]]) + 0.5))[0] * 40.0
            assert tuple(picture[int(400 - y), int(x)]) == colours[codes[row, column]]
    x, y = transform(corner, np.array([[-0.2, -0.2]]))[0] * 40.0
    assert tuple(picture[int(400 - y), int(x)]) == WHITE


def test_what_lies_far_outside_does_no_harm() -> None:
    canvas, far = Canvas((50, 50), (0.0, 0.0), 10.0, WHITE), np.array([[1e9, -1e9], [2e9, 5.0]])
    canvas.discs(far, 3.0, BLACK, BLACK)
    canvas.polyline(far, BLACK)
    canvas.dashes(far, BLACK)
    canvas.ellipses(far, np.tile(1e12 * np.eye(2), (2, 1, 1)), None, BLACK)
    assert pixels(canvas.picture()).shape == (50, 50, 3)


def test_without_pygame_the_error_names_the_extra() -> None:
    code = "import sys; sys.modules['pygame'] = None; import slam_gym.rendering.explore_view"
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode != 0 and "slam_gym[render]" in done.stderr


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
