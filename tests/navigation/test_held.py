"""Paths that hold for sure, against the wavefront: whatever the walk is sure of, the wavefront says as well."""

import math

import numpy as np
import pytest

from slam_gym.navigation.explored_grid import FREE, WALL
from slam_gym.navigation.held import surely_holds
from slam_gym.navigation.planner import distance_field
from slam_gym.navigation.polyline import length_left, next_stretch, points_ahead
from tests.navigation.test_planner import centre, grid_of, random_cells

CLEARANCE, SPACING, AHEAD, LONGER, AROUND = 0.25, 0.2, 6.0, 1.1, 6.0


def holds(grid, path, here) -> bool:
    """The same by a wavefront within a rectangle around the stretch."""
    cells = [
        tuple(np.floor((p - grid.origin) / grid.resolution).astype(int)[::-1])
        for p in points_ahead(path, here, SPACING)
    ]
    if any(grid.cells[cell] != FREE for cell in cells):
        return False
    stretch, _ = next_stretch(path, here, AHEAD)
    within = np.concatenate([stretch.min(axis=0) - AROUND, stretch.max(axis=0) + AROUND])
    field = distance_field(grid, here, CLEARANCE, within)
    fresh = field.path(stretch[-1])
    reached = len(fresh) and np.isfinite(field.lengths_to(points_ahead(stretch, here, SPACING))).all()
    return bool(reached) and length_left(stretch, here) < LONGER * length_left(fresh, here)


def surely(grid, path, here) -> bool:
    return surely_holds((grid.cells, grid.origin, grid.resolution), path, here, CLEARANCE, SPACING, AHEAD, LONGER)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_sure_is_what_the_wavefront_says(seed) -> None:
    rng, told = np.random.default_rng(seed), np.zeros((2, 2), int)
    for _ in range(60):
        cells = random_cells(rng, (50, 60))
        cells[open_space(rng, cells.shape)] = FREE
        grid = grid_of(cells)
        free = np.argwhere(cells == FREE)
        field = distance_field(grid, centre(grid, *rng.choice(free)), CLEARANCE)
        ends = np.argwhere(np.isfinite(field.lengths))
        path = field.path(centre(grid, *rng.choice(ends)))
        if len(path) < 2:
            continue
        at = rng.uniform() * math.dist(path[0], path[1])
        here = path[0] + at * (path[1] - path[0]) / max(math.dist(path[0], path[1]), 1e-9) + rng.normal(0.0, 0.2, 2)
        for row, column in rng.choice(free, 4):  # what has been drawn meanwhile
            grid._cells[row, column] = WALL
        told[int(surely(grid, path, here)), int(holds(grid, path, here))] += 1
    assert told[1, 0] == 0 and told[1, 1] >= 5 and told[0, 0] >= 5, told


def open_space(rng, shape):
    """A rectangle of open space."""
    corner = rng.integers(0, np.array(shape) // 2)
    side = rng.integers(8, np.array(shape) // 2)
    return tuple(slice(a, a + b) for a, b in zip(corner, side))


def test_an_open_hall_by_hand() -> None:
    grid = grid_of(np.full((60, 60), FREE, np.uint8))
    start = centre(grid, 30, 10)
    path = np.array([start, start + np.array([4.0, 0.0])])
    assert surely(grid, path, start) and surely(grid, path, start + np.array([1.0, 0.3]))
    assert not surely(grid, path, start + np.array([1.0, 3.5]))  # too far off the path to be sure
    detour = np.array([start, start + np.array([2.0, 2.0]), start + np.array([4.0, 0.0])])
    assert not surely(grid, detour, start)
    grid._cells[31, 20] = WALL  # beside the way: nearer than the clearance
    assert not surely(grid, path, start)
    assert surely(grid, path, centre(grid, 30, 20))  # a robot that is too near to a wall may leave it
