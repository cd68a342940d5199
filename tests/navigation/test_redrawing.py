"""Moving sweeps within the explored grid, against grids into which they were entered where they belong."""

import numpy as np
import pytest

from slam_gym.navigation.explored_grid import FREE, UNKNOWN, WALL, ExploredGrid
from slam_gym.navigation.grid import BLOCK
from slam_gym.types import Beams

BOUNDS = np.array([-8.0, -7.0, 8.0, 7.5])
BEARINGS = np.linspace(-np.pi, np.pi, 30, endpoint=False)
NOWHERE = np.full(3, np.nan)


def drawn_sweeps(rng, count):
    """Sweeps with echoes anywhere, and the poses that they are taken from."""
    poses = np.column_stack([rng.uniform(-3, 3, (count, 2)), rng.uniform(-3, 3, count)])
    return poses, np.where(rng.random((count, 30)) < 0.2, 6.0, rng.uniform(0.5, 6.0, (count, 30)))


def grid_of(poses, ranges, movable=True):
    grid = ExploredGrid(BOUNDS, 0.25)
    for pose, row in zip(poses, ranges):
        grid.integrate(pose, Beams(BEARINGS, row, 6.0), movable)
    return grid


def classes(poses, ranges):
    """Class of each cell by the number of sweeps with an echo in it, and of those that crossed it."""
    hits, crossings = (np.zeros(ExploredGrid(BOUNDS, 0.25).cells.shape, int) for _ in range(2))
    for pose, row in zip(poses, ranges):
        alone = grid_of([pose], [row]).cells  # one echo outweighs all crossings of its sweep
        hits, crossings = hits + (alone == WALL), crossings + (alone == FREE)
    return np.where(hits + crossings == 0, UNKNOWN, np.where(3 * hits > crossings, WALL, FREE))


def assert_books_agree(grid):
    cells = grid.cells
    padded = np.pad(cells, [(0, side % BLOCK) for side in cells.shape])
    blocks = padded.reshape(padded.shape[0] // BLOCK, BLOCK, -1, BLOCK)
    free, walls = ((blocks == kind).sum(axis=(1, 3)) for kind in (FREE, WALL))
    np.testing.assert_array_equal(grid._blocks, free + 256 * walls)


@pytest.mark.parametrize("seed", range(5))
def test_moved_cells_are_what_the_sweeps_say_at_their_new_poses(seed):
    rng = np.random.default_rng(seed)
    poses, ranges = drawn_sweeps(rng, 40)
    grid, moved = grid_of(poses, ranges), rng.choice(40, 15, replace=False)
    before, after = grid.cells.copy(), poses.copy()
    after[moved] += rng.normal(0, 0.5, (15, 3))
    grid.move(poses[moved], after[moved], Beams(BEARINGS, ranges[moved], 6.0))
    found, expected, kept = grid.cells, classes(after, ranges), classes(poses, ranges)
    changed = expected != kept
    assert changed.sum() > 50
    np.testing.assert_array_equal(found[changed], expected[changed])
    assert ((found == expected) | (found == before)).all()  # where no number changed, what came last still counts
    np.testing.assert_array_equal(found == UNKNOWN, expected == UNKNOWN)
    assert_books_agree(grid)


def test_sweeps_are_taken_out_and_put_in_again():
    rng = np.random.default_rng(0)
    poses, ranges = drawn_sweeps(rng, 20)
    grid, nowhere = grid_of(poses, ranges), np.tile(NOWHERE, (20, 1))
    grid.move(poses, nowhere, Beams(BEARINGS, ranges, 6.0))
    assert (grid.cells == UNKNOWN).all()
    assert_books_agree(grid)
    order = rng.permutation(20)
    grid.move(nowhere, poses[order], Beams(BEARINGS, ranges[order], 6.0))
    np.testing.assert_array_equal(grid.cells, classes(poses, ranges))
    assert_books_agree(grid)


def test_a_move_to_where_they_are_changes_nothing():
    poses, ranges = drawn_sweeps(np.random.default_rng(1), 30)
    grid = grid_of(poses, ranges)
    before = grid.cells.copy()
    grid.move(poses, poses.copy(), Beams(BEARINGS, ranges, 6.0))
    np.testing.assert_array_equal(grid.cells, before)


def test_a_moved_wall_gives_way_to_new_evidence_as_any_other():
    grid = ExploredGrid(np.array([0.0, 0.0, 5.0, 1.0]))
    pose, ahead = np.array([0.1, 0.5, 0.0]), np.zeros(1)
    for _ in range(50):
        grid.integrate(pose, Beams(ahead, np.array([2.05]), 6.0), movable=True)
    shifted = pose + np.array([1.0, 0.0, 0.0])
    ranges = np.full((50, 1), 2.05)
    grid.move(np.tile(pose, (50, 1)), np.tile(shifted, (50, 1)), Beams(ahead, ranges, 6.0))
    assert grid.cells[2, 10] == FREE and grid.cells[2, 15] == WALL and grid.cells[2, 1] == UNKNOWN
    for _ in range(9):
        grid.integrate(pose, Beams(ahead, np.array([4.0]), 6.0))
    assert grid.cells[2, 15] == FREE


def test_the_view_that_others_hold_shows_the_moved_cells():
    poses, ranges = drawn_sweeps(np.random.default_rng(2), 5)
    grid = grid_of(poses, ranges)
    view = grid.explored
    grid.move(poses, poses + np.array([1.0, 0.0, 0.0]), Beams(BEARINGS, ranges, 6.0))
    np.testing.assert_array_equal(view.cells, grid.cells)
