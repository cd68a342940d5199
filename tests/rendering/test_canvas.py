"""A canvas in metres: ellipses hold what they say, cells lie where they are put, nothing overflows."""

import os
import subprocess
import sys

import numpy as np
import pytest

from slam_gym.geometry import observe, transform
from slam_gym.rendering.canvas import SUPERSAMPLING, Canvas, pixels, pygame

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
def test_cells_lie_where_their_corner_puts_them_and_walls_have_no_teeth(heading) -> None:
    corner, codes = np.array([5.0, 4.0, heading]), np.ones((12, 18), np.uint8)
    codes[:, 14:] = 0
    x = np.linspace(0.0, 13.9, 500)
    codes[(3.0 + 0.4 * x).astype(int), x.astype(int)] = 2  # a straight wall, in cells
    canvas, free, wall = Canvas((400, 400), (0.0, 0.0), 40.0, WHITE), (20, 0, 0), (30, 0, 0)
    canvas.cells(codes, free, wall, corner, 0.2)
    picture = pixels(canvas.picture())
    for column, row, colour in ((2, 7, free), (12, 4, free), (6, 1, free), (16, 6, WHITE), (-2, -2, WHITE)):
        x, y = transform(corner, 0.2 * np.array([[column, row]]))[0] * 40.0
        assert tuple(picture[int(400 - y), int(x)]) == colour
    rows, columns = np.nonzero((picture == wall).all(axis=2))
    x, y = observe(corner, np.stack([columns + 0.5, 399.5 - rows], axis=1) / 40.0).T / 0.2
    assert x.min() < 1.0 and x.max() > 13.0
    assert (np.abs(y - 3.0 - 0.4 * x) / np.hypot(1.0, 0.4)).max() < 0.75  # that of the cells reaches 1.1


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
