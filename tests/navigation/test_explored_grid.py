"""The explored grid against brute force: cells that beams cross, frontiers, what can be seen from where."""

import copy
import math
import pickle

import numpy as np
import pytest

from slam_gym.navigation.explored_grid import FREE, UNKNOWN, WALL, ExploredGrid
from slam_gym.types import Beams

BEARINGS = np.linspace(-math.pi, math.pi, 40, endpoint=False)
NO_FEATURES = np.empty((0, 2))


def sweep(ranges, bearings=BEARINGS, max_range=6.0):
    return Beams(bearings, np.asarray(ranges, dtype=float), max_range)


def box_ranges(pose, bounds, max_range=6.0):
    """Exact ranges from inside an axis-aligned box."""
    dx, dy = np.cos(pose[2] + BEARINGS), np.sin(pose[2] + BEARINGS)
    with np.errstate(divide="ignore"):
        to_x = np.where(dx > 0, bounds[2] - pose[0], bounds[0] - pose[0]) / dx
        to_y = np.where(dy > 0, bounds[3] - pose[1], bounds[1] - pose[1]) / dy
    return np.minimum(np.minimum(to_x, to_y), max_range)


@pytest.mark.parametrize("heading", [0.0, 0.4, math.pi / 4, 2.0])
def test_room_is_mapped_where_it_is(heading):
    """A room of 5 × 3.4 m in a base frame turned by any angle: walls within a cell of the true ones, no frontier."""
    rng = np.random.default_rng(2)
    c, s = math.cos(heading), math.sin(heading)
    to_base = np.array([[c, s], [-s, c]])  # rows of W → B
    grid = ExploredGrid(np.array([-7.0, -7.0, 7.0, 7.0]))
    room = np.array([-2.5, -1.7, 2.5, 1.7])
    for _ in range(400):
        pose = np.array([*rng.uniform([-2.2, -1.4], [2.2, 1.4]), rng.uniform(-4, 4)])
        ranges = box_ranges(pose, room) + 0.03 * rng.normal(size=40)
        grid.integrate(np.array([*(to_base @ pose[:2]), pose[2] - heading]), sweep(ranges))
    rows, columns = np.nonzero(grid.cells == WALL)
    walls = (grid.origin + (np.stack([columns, rows], axis=1) + 0.5) * grid.resolution) @ to_base
    off = np.abs(np.abs(walls) - room[2:])
    assert (off.min(axis=1) < 0.25).all()
    assert (np.abs(walls) < room[2:] + 0.25).all()
    assert abs((grid.cells == FREE).sum() * grid.resolution**2 - 5.0 * 3.4) < 3.4
    assert len(grid.frontiers()) == 0


def test_wall_that_has_gone_is_washed_out_in_nine_sweeps():
    grid = ExploredGrid(np.array([0.0, 0.0, 5.0, 1.0]))
    pose, ahead = np.array([0.1, 0.5, 0.0]), np.zeros(1)
    for _ in range(100):
        grid.integrate(pose, sweep([2.05], ahead))
    assert grid.cells[2, 10] == WALL
    for _ in range(8):
        grid.integrate(pose, sweep([4.0], ahead))
    assert grid.cells[2, 10] == WALL
    grid.integrate(pose, sweep([4.0], ahead))
    assert grid.cells[2, 10] == FREE
    for _ in range(3):
        grid.integrate(pose, sweep([2.05], ahead))
    assert grid.cells[2, 10] == WALL


def test_echo_is_not_erased_by_other_beams_of_its_sweep():
    grid = ExploredGrid(np.array([0.0, 0.0, 5.0, 1.0]))
    grid.integrate(np.array([0.1, 0.5, 0.0]), sweep([4.0, 2.05, 4.0, 4.0], np.array([0.0, 0.0, 0.01, -0.01])))
    assert grid.cells[2, 10] == WALL


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
        ([0, 0, 1, 1], 0.0, "resolution"),
        ([0, 0, 1, 1], math.nan, "resolution"),
    ],
)
def test_absurd_grids_are_refused(bounds, resolution, name):
    with pytest.raises(ValueError, match=name):
        ExploredGrid(np.array(bounds, dtype=float), resolution)


def test_copies_are_independent_and_the_view_is_read_only():
    rng = np.random.default_rng(3)
    grid = ExploredGrid(np.array([-3.0, -3.0, 3.0, 3.0]))
    grid.integrate(np.zeros(3), sweep(rng.uniform(0, 6, 40)))
    twins = [copy.deepcopy(grid), pickle.loads(pickle.dumps(grid))]
    ranges = rng.uniform(0, 6, 40)
    for each in (grid, *twins):
        each.integrate(np.array([0.3, 0.2, 0.1]), sweep(ranges))
    for twin in twins:
        assert np.array_equal(twin.cells, grid.cells)
    with pytest.raises(ValueError):
        grid.cells[0, 0] = WALL
