"""The explored grid against brute force: cells that beams cross, sweeps moved, areas in view, images."""

import math

import numpy as np
import pytest

from slam_gym.navigation.explored_grid import BLOCK, FREE, UNKNOWN, WALL, ExploredGrid
from slam_gym.types import Beams

BOUNDS = np.array([-8.0, -7.0, 8.0, 7.5])
BEARINGS = np.linspace(-math.pi, math.pi, 40, endpoint=False)
NO_FEATURES = np.empty((0, 2))


def sweep(ranges, bearings=BEARINGS, max_range=6.0):
    return Beams(bearings, np.asarray(ranges, dtype=float), max_range)


def test_bad_readings_are_ignored_and_bad_poses_refused():
    grid = ExploredGrid(np.array([0.0, 0.0, 2.0, 2.0]))
    grid.integrate(np.array([1.0, 1.0, 0.0]), sweep([math.nan, -1.0, -math.inf], np.zeros(3)))
    assert (grid.cells == UNKNOWN).all()
    grid.integrate(np.array([1.0, 1.0, 0.0]), sweep([math.inf], np.zeros(1)))
    assert grid.cells[5, 5] == FREE and not (grid.cells == WALL).any()
    before = grid.cells.copy()
    for pose in ([math.nan, 0.0, 0.0], [0.0, math.inf, 0.0], [0.0, 0.0, math.nan]):
        with pytest.raises(ValueError, match="pose"):
            grid.integrate(np.array(pose), sweep([1.0], np.zeros(1)))
    assert np.array_equal(grid.cells, before)
    grid.integrate(np.array([99.0, -1e9, 0.0]), sweep(np.full(40, 3.0)))  # far off the grid: nothing to enter
    assert np.array_equal(grid.cells, before)


@pytest.mark.parametrize(
    ("bounds", "resolution", "name"),
    [
        ([0, 0, 0, 1], 0.2, "bounds"),
        ([0, 0, 1, math.nan], 0.2, "bounds"),
        ([0, 0, 1], 0.2, "bounds"),
        ([0, 0, 1e6, 1e6], 0.2, "bounds"),
        ([0, 0, 1, 1], 0.0, "side of a cell"),
        ([0, 0, 1, 1], math.nan, "side of a cell"),
    ],
)
def test_absurd_grids_are_refused(bounds, resolution, name):
    with pytest.raises(ValueError, match=name):
        ExploredGrid(np.array(bounds, dtype=float), resolution)


def crossed(start, end, shape):
    """Cells (h, w) in which the segment from `start` to `end` [cells] has some length: clipped against every cell."""
    low = np.stack(np.meshgrid(np.arange(shape[1]), np.arange(shape[0])), axis=-1).astype(float)
    delta = end - start
    a, b = (low - start) / delta, (low + 1.0 - start) / delta
    enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return np.minimum(leave, 1.0) - np.maximum(enter, 0.0) > 1e-12


def test_evidence_of_a_sweep_is_that_of_every_cell_clipped_against_every_beam():
    rng = np.random.default_rng(1)
    grid = ExploredGrid(np.array([-3.0, -2.0, 4.0, 3.1]), 0.2)
    shape = grid.cells.shape
    evidence, cells = np.zeros(shape, dtype=int), np.full(shape, UNKNOWN)
    for _ in range(40):
        pose = np.array([*rng.uniform([-3, -2], [4, 3]), rng.uniform(-4, 4)])
        ranges = np.where(rng.random(40) < 0.3, 6.0, rng.uniform(0.0, 6.0, 40))
        grid.integrate(pose, sweep(ranges))
        start = (pose[:2] - grid.origin) / 0.2
        hit, miss = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
        for bearing, reading in zip(BEARINGS, ranges):
            end = start + reading / 0.2 * np.array([math.cos(pose[2] + bearing), math.sin(pose[2] + bearing)])
            miss |= crossed(start, end, shape)
            column, row = np.floor(end).astype(int)
            if reading < 6.0 and 0 <= row < shape[0] and 0 <= column < shape[1]:
                hit[row, column] = True
        evidence = np.clip(evidence + np.where(hit, 3, np.where(miss, -1, 0)), -8, 8)
        cells = np.where(evidence == 0, cells, np.where(evidence > 0, WALL, FREE))
        assert np.array_equal(grid.cells, cells)


def test_expected_area_of_discs_half_discs_and_rooms():
    grid = ExploredGrid(np.array([-10.0, -10.0, 10.0, 10.0]))
    origin = np.zeros((1, 2))
    assert grid.expected_area(origin, 5.0)[0] == pytest.approx(25 * math.pi)
    grid._cells[:, 50:] = FREE  # x > 0 is known
    assert grid.expected_area(origin, 5.0, rays=720)[0] == pytest.approx(12.5 * math.pi, rel=0.01)
    grid._cells[:] = UNKNOWN
    grid._cells[40, 30:71] = grid._cells[60, 30:71] = grid._cells[40:61, 30] = grid._cells[40:61, 70] = WALL
    inside = 19 * 0.2 * 39 * 0.2  # cells 41..59 × 31..69
    areas = grid.expected_area(np.array([[0.1, 0.1], [-3.0, 1.1], [3.7, -1.7]]), 12.0, rays=7200)
    assert areas == pytest.approx(inside, rel=0.01)
    assert grid.expected_area(np.array([[50.0, 0.0]]), 5.0)[0] == 0.0


def explored_grid(rng):
    grid = ExploredGrid(np.array([-4.0, -3.0, 5.0, 4.0]))
    for _ in range(60):
        pose = np.array([*rng.uniform([-3.5, -2.5], [4.5, 3.5]), rng.uniform(-4, 4)])
        grid.integrate(pose, sweep(rng.uniform(0.5, 6.0, 40)))
    return grid


def test_egocentric_image_is_the_grid_sampled_in_the_robots_frame():
    rng = np.random.default_rng(5)
    for _ in range(10):
        grid = explored_grid(rng)
        padded = np.pad(grid.cells, [(0, side % 2) for side in grid.cells.shape])
        blocks = padded.reshape(padded.shape[0] // 2, 2, padded.shape[1] // 2, 2)
        counts = [(blocks == kind).sum(axis=(1, 3)) for kind in (FREE, WALL)]
        pose = np.array([*rng.uniform(-6, 6, 2), rng.uniform(-4, 4)])
        image = grid.egocentric(pose, NO_FEATURES)
        sums = np.zeros((2, 48, 48), dtype=int)
        rows, columns = np.mgrid[:48, :48]
        for quarter in (0.25, 0.75):
            ahead, left = 12.0 - (rows + quarter) * 0.5, 12.0 - (columns + quarter) * 0.5
            x = pose[0] + math.cos(pose[2]) * ahead - math.sin(pose[2]) * left
            y = pose[1] + math.sin(pose[2]) * ahead + math.cos(pose[2]) * left
            c, r = np.floor((x - grid.origin[0]) / 0.4).astype(int), np.floor((y - grid.origin[1]) / 0.4).astype(int)
            inside = (r >= 0) & (r < counts[0].shape[0]) & (c >= 0) & (c < counts[0].shape[1])
            for kind in range(2):
                sums[kind][inside] += counts[kind][r[inside], c[inside]]
        expected = np.stack([sums[0] * 255 // 8, np.minimum(255, sums[1] * 64)])
        assert (image[:2] != expected).mean() < 0.002  # fixed point: only samples within 1e-3 of a border may differ
        assert not image[2].any()


def drawn_sweeps(rng, count):
    """Sweeps with echoes anywhere, and the poses that they are taken from."""
    poses = np.column_stack([rng.uniform(-3, 3, (count, 2)), rng.uniform(-3, 3, count)])
    return poses, np.where(rng.random((count, 40)) < 0.2, 6.0, rng.uniform(0.5, 6.0, (count, 40)))


def entered(poses, ranges, movable=True):
    grid = ExploredGrid(BOUNDS, 0.25)
    for pose, row in zip(poses, ranges):
        grid.integrate(pose, Beams(BEARINGS, row, 6.0), movable)
    return grid


def classes(poses, ranges):
    """Class of each cell by the number of sweeps with an echo in it, and of those that crossed it."""
    hits, crossings = (np.zeros(ExploredGrid(BOUNDS, 0.25).cells.shape, int) for _ in range(2))
    for pose, row in zip(poses, ranges):
        alone = entered([pose], [row]).cells  # one echo outweighs all crossings of its sweep
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
    grid, moved = entered(poses, ranges), rng.choice(40, 15, replace=False)
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
    grid, nowhere = entered(poses, ranges), np.full((20, 3), np.nan)
    grid.move(poses, nowhere, Beams(BEARINGS, ranges, 6.0))
    assert (grid.cells == UNKNOWN).all()
    assert_books_agree(grid)
    order = rng.permutation(20)
    grid.move(nowhere, poses[order], Beams(BEARINGS, ranges[order], 6.0))
    np.testing.assert_array_equal(grid.cells, classes(poses, ranges))
    assert_books_agree(grid)
