"""The wavefront against Dijkstra on the explicit graph, the paths that it leads to, and how they are followed."""

import itertools
import math

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from slam_gym.navigation.explored_grid import FREE, UNKNOWN, WALL, ExploredGrid
from slam_gym.navigation.planner import CROWDING, MARGIN, STEPS, distance_field
from slam_gym.navigation.pursuit import follow, next_stretch
from tests.oracles.statistics import for_seeds

RESOLUTION = 0.2
LIMITS = 1.0, 2.0  # [m/s], [rad/s] speeds of the robot


def grid_of(cells):
    """A grid with these cells, its lower left corner at (−1, 2)."""
    grid = ExploredGrid(np.array([-1.0, 2.0, -1.0 + cells.shape[1] * RESOLUTION, 2.0 + cells.shape[0] * RESOLUTION]))
    assert grid.cells.shape == cells.shape
    grid._cells[:] = cells
    return grid


def centre(grid, row, column):
    return grid.origin + (np.array([column, row]) + 0.5) * grid.resolution


def random_cells(rng, shape=(25, 32)):
    noise = ndimage.gaussian_filter(rng.normal(size=shape), rng.uniform(0.6, 1.5))
    return np.digitize(noise, np.quantile(noise, [0.12, 0.8])).astype(np.uint8)


def costs_by_graph(cells, start, clearance):
    """Least costs [cells] to every cell from the explicit graph of all legal steps, and the weights of the cells."""
    distances = np.inf if not (cells == WALL).any() else ndimage.distance_transform_edt(cells != WALL) * RESOLUTION
    weights = 1.0 + CROWDING * np.clip(1.0 - distances / (clearance + MARGIN), 0.0, None) ** 2
    weights = np.where(cells == FREE, weights, np.inf)
    closed = (cells == FREE) & (distances < clearance - 1e-9)
    h, w = cells.shape
    entries = []
    for r in range(h):
        for c in range(w):
            is_start = (r, c) == start
            if not (is_start or cells[r, c] == FREE):
                continue
            weight = weights[r, c] if cells[r, c] == FREE else 1.0 + CROWDING
            for dr, dc in STEPS:
                r1, c1 = r + dr, c + dc
                if not (0 <= r1 < h and 0 <= c1 < w) or cells[r1, c1] != FREE:
                    continue
                if dr and dc and (cells[r, c1] != FREE or cells[r1, c] != FREE):
                    continue
                if closed[r1, c1] and not (closed[r, c] or is_start):
                    continue
                cost = math.hypot(dr, dc) * (weight + weights[r1, c1]) / 2.0
                entries.append((cost, r * w + c, r1 * w + c1))
    values, rows, columns = zip(*entries)
    graph = csr_matrix((values, (rows, columns)), shape=(h * w, h * w))
    return dijkstra(graph, indices=start[0] * w + start[1]).reshape(h, w), weights


def length_to(field, point):
    """Length [m] of the path to one point (2,)."""
    return field.lengths_to(np.asarray(point)[None])[0]


@for_seeds(25)
def test_costs_are_those_of_dijkstra_on_the_explicit_graph(seed):
    rng = np.random.default_rng(seed)
    cells = random_cells(rng)
    clearance = rng.choice([0.0, 0.2, 0.25, 0.4])
    kind = FREE if seed < 20 else rng.choice([WALL, UNKNOWN])  # a start where no robot should be still leads out
    start = tuple(rng.choice(np.argwhere(cells == kind)))
    grid = grid_of(cells)
    field = distance_field(grid, centre(grid, *start), clearance)
    expected, weights = costs_by_graph(cells, start, clearance)
    assert np.array_equal(np.isfinite(field.costs), np.isfinite(expected))
    reached = np.isfinite(expected)
    assert np.allclose(field.costs[reached], expected[reached], rtol=1e-12)
    assert np.allclose(field.weights[field.levels], weights, rtol=1e-12)
    assert np.array_equal(np.isfinite(field.lengths), reached)
    for row, column in rng.permutation(np.argwhere(reached))[:20]:  # a length is that of the steps back to the start
        length, r, c = 0.0, row, column
        while field.steps[r, c] >= 0:
            dr, dc = STEPS[field.steps[r, c]]
            length, r, c = length + math.hypot(dr, dc) * RESOLUTION, r - dr, c - dc
        assert (r, c) == start and field.lengths[row, column] == pytest.approx(length)


@for_seeds(10)
def test_paths_are_short_legal_and_no_dearer(seed):
    rng = np.random.default_rng(100 + seed)
    cells = random_cells(rng, (60, 80))
    grid = grid_of(cells)
    free = np.argwhere(cells == FREE)
    field = distance_field(grid, centre(grid, *rng.choice(free)), 0.2)
    for row, column in rng.permutation(np.argwhere(np.isfinite(field.lengths)))[:30]:
        goal = centre(grid, row, column) + rng.uniform(-0.09, 0.09, 2)
        path = field.path(goal)
        assert np.array_equal(path[0], field.start) and np.array_equal(path[-1], goal)
        inner = np.concatenate([[centre(grid, *field.cell(path[0]))], path[1:-1], [centre(grid, row, column)]])
        cost, length = 0.0, 0.0
        for a, b in itertools.pairwise(inner):
            points = a + (np.linspace(0.0, 1.0, 2000, endpoint=False)[:, None] + 1 / 4000) * (b - a)
            walked = tuple(np.floor((points - grid.origin) / RESOLUTION).astype(int).T[::-1])
            assert np.isfinite(field.costs[walked]).all()
            length += np.hypot(*(b - a))
            cost += np.hypot(*(b - a)) / RESOLUTION * field.weights[field.levels[walked]].mean()
        assert cost <= field.costs[row, column] * 1.01 + 0.05
        assert length <= field.lengths[row, column] + 1e-9


@pytest.mark.parametrize("width", [3, 4, 5, 9])
def test_passages_are_taken_in_the_middle(width):
    """A door `width` cells wide in a wall two cells thick; start and goal hug one side of their rooms."""
    cells = np.full((41, 60), FREE, dtype=np.uint8)
    first = (41 - width) // 2
    cells[:, 30:32] = WALL
    cells[first : first + width, 30:32] = FREE
    grid = grid_of(cells)
    path = distance_field(grid, centre(grid, 2, 3), 0.25).path(centre(grid, 2, 57))
    middle = grid.origin[1] + (first + width / 2.0) * RESOLUTION
    at_door = np.interp(grid.origin[0] + 31 * RESOLUTION, path[:, 0], path[:, 1])
    room = width * RESOLUTION / 2.0
    assert abs(at_door - middle) <= max(0.11, room - 0.49)


def test_gaps_too_narrow_and_goals_unreachable():
    cells = np.full((21, 40), FREE, dtype=np.uint8)
    cells[:, 20] = WALL
    cells[10, 20] = FREE
    grid = grid_of(cells)
    start, goal = centre(grid, 10, 3), centre(grid, 10, 37)
    assert length_to(distance_field(grid, start, 0.2), goal) == pytest.approx(34 * RESOLUTION)
    field = distance_field(grid, start, 0.25)
    assert length_to(field, goal) == math.inf and field.path(goal).shape == (0, 2)
    assert length_to(field, np.array([99.0, 0.0])) == math.inf and field.path(np.array([99.0, 0.0])).shape == (0, 2)
    nearest = field.nearest(goal)
    assert np.isfinite(length_to(field, nearest)) and nearest[0] == pytest.approx(centre(grid, 10, 19)[0])


def test_a_start_off_the_grid_leads_nowhere():
    grid = grid_of(np.full((30, 30), FREE, dtype=np.uint8))
    outside = distance_field(grid, np.array([-50.0, 0.0]), 0.25)
    assert np.isinf(outside.lengths).all() and np.array_equal(outside.nearest(np.zeros(2)), [-50.0, 0.0])
    for clearance in (-0.1, math.nan, math.inf):
        with pytest.raises(ValueError, match="clearance"):
            distance_field(grid, np.zeros(2), clearance)


def test_a_field_within_a_rectangle_is_that_of_its_cells_alone():
    rng = np.random.default_rng(5)
    cells = random_cells(rng, (40, 50))
    cells[18:23, 20:26] = FREE
    grid, alone = grid_of(cells), grid_of(cells[8:33, 10:42])
    start, low = centre(grid, 20, 22), grid.origin + np.array([10, 8]) * RESOLUTION
    within = np.concatenate([low + 0.1, low + np.array([32, 25]) * RESOLUTION - 0.1])
    field, expected = distance_field(grid, start, 0.25, within), distance_field(alone, centre(alone, 12, 12), 0.25)
    np.testing.assert_array_equal(field.lengths, expected.lengths)
    np.testing.assert_allclose(field.origin, low)
    goal = centre(grid, 21, 24)
    assert length_to(field, goal) == length_to(expected, centre(alone, 13, 14)) and len(field.path(goal)) >= 2
    assert length_to(field, centre(grid, 2, 2)) == math.inf


# --- pure pursuit turns first, slows down, rests, and keeps its limits ------------------------------------------------


def test_the_next_stretch_and_the_rest_make_up_the_path() -> None:
    path = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 20.0], [30.0, 20.0]])
    stretch, rest = next_stretch(path, np.array([1.0, 0.2]), 15.0)
    np.testing.assert_allclose(stretch, [[0, 0], [4, 0], [4, 12.0]])
    np.testing.assert_array_equal(rest, path[2:])
    stretch, rest = next_stretch(path, np.array([20.0, 20.1]), 15.0)
    np.testing.assert_array_equal(stretch, path[2:])
    assert len(rest) == 0


def test_follow_turns_first_slows_down_and_rests():
    path = np.array([[0.0, 0.0], [5.0, 0.0]])
    forward, turn = follow(np.array([0.0, 0.0, 0.0]), path, *LIMITS)
    assert forward == pytest.approx(1.0) and turn == pytest.approx(0.0)
    for heading in (math.pi - 0.01, 2.0, 0.8):  # facing away: turn on the spot, the shorter way round
        assert follow(np.array([0.0, 0.0, heading]), path, *LIMITS) == (0.0, -1.0)
        assert follow(np.array([0.0, 0.0, -heading]), path, *LIMITS) == (0.0, 1.0)
    assert 0.0 < follow(np.array([4.9, 0.0, 0.0]), path, *LIMITS)[0] < 0.6
    assert follow(np.array([5.0, 0.01, 1.0]), path, *LIMITS) == (0.0, 0.0)
    assert follow(np.zeros(3), np.empty((0, 2)), *LIMITS) == (0.0, 0.0)
    beside = follow(np.array([1.0, 0.3, 0.0]), path, *LIMITS)
    mirrored = follow(np.array([1.0, -0.3, 0.0]), path, *LIMITS)
    assert beside[1] < 0 and beside == pytest.approx((mirrored[0], -mirrored[1]))
