"""Paths that stay in sight of features: what they cost, where they lead, and that nobody pays who did not ask."""

import numpy as np
import pytest

from slam_gym.navigation.expected_gain import features_in_sight
from slam_gym.navigation.explored_grid import FREE, WALL
from slam_gym.navigation.planner import distance_field
from slam_gym.navigation.sight import ENOUGH, LOOKOUT, Sight
from tests.navigation.test_planner import RESOLUTION, centre, costs_by_graph, grid_of, random_cells

REACH = 1.5


def state_of(features):
    return np.concatenate([np.zeros(3), np.ravel(features)])


def prices_of(grid, cells, sight):
    """(h, w) by looking, from the free cell nearest to the middle of each square, at what is in view."""
    side, (h, w), out = round(LOOKOUT / RESOLUTION), cells.shape, np.ones(cells.shape)
    for top in range(0, h, side):
        for left in range(0, w, side):
            square = np.argwhere(cells[top : top + side, left : left + side] == FREE)
            if len(square):
                best = square[np.argmin(((square - (side - 1) / 2) ** 2).sum(axis=1))]
                place = centre(grid, top + best[0], left + best[1])
                seen = int(features_in_sight(sight.state, grid, place[None], sight.reach)[0])
                out[top : top + side, left : left + side] += sight.price * max(0, ENOUGH - seen) / ENOUGH
    return out


@pytest.mark.parametrize("seed", range(8))
def test_costs_are_those_of_dijkstra_on_the_explicit_graph_with_prices(seed):
    rng = np.random.default_rng(seed)
    cells = random_cells(rng, (23, 32))  # the last squares are cut off
    clearance = rng.choice([0.0, 0.2, 0.4])
    grid, start = grid_of(cells), tuple(rng.choice(np.argwhere(cells == FREE)))
    features = grid.origin + rng.uniform(0.0, 1.0, (8, 2)) * np.array(cells.shape[::-1]) * RESOLUTION
    sight = Sight(state_of(features), REACH, float(rng.choice([0.5, 4.0, 60.0])))
    prices = prices_of(grid, cells, sight)
    assert len(np.unique(prices)) == 3
    field = distance_field(grid, centre(grid, *start), clearance, sight=sight)
    expected, weights = costs_by_graph(cells, start, clearance, prices)
    reached = np.isfinite(expected)
    assert reached.sum() > 10 and np.array_equal(np.isfinite(field.costs), reached)
    np.testing.assert_allclose(field.costs[reached], expected[reached], rtol=1e-12)
    np.testing.assert_allclose(field.weights[field.levels], weights, rtol=1e-12)
    straight = distance_field(grid, centre(grid, *start), clearance)
    assert (field.costs[reached] <= (1.0 + sight.price) * straight.costs[reached] + 1e-9).all()
    assert (field.costs[reached] >= straight.costs[reached] - 1e-9).all()


def hall():
    """A hall of 20 by 12 m with features along the wall at its foot, and the ends of a way through its middle."""
    cells = np.full((60, 100), FREE, np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = WALL
    grid = grid_of(cells)
    features = np.stack([np.arange(0.5, 20.0, 1.0), np.full(20, 0.1)], axis=1) + grid.origin
    return grid, features, centre(grid, 30, 4), centre(grid, 30, 95)


def test_the_way_through_a_hall_bends_towards_the_features_and_its_length_is_bounded_by_the_price():
    grid, features, start, goal = hall()
    straight = distance_field(grid, start, 0.25).length_to(goal)
    lowest = []
    for price in (0.0, 0.1, 0.5, 4.0):
        field = distance_field(grid, start, 0.25, sight=Sight(state_of(features), 4.0, price))
        assert straight <= field.length_to(goal) <= (1.0 + price) * straight + 1e-9
        way = field.along(goal, RESOLUTION)
        lowest.append(way[:, 1].min() - grid.origin[1])
        if price == 4.0:
            seen = features_in_sight(state_of(features), grid, way, 4.0)
            assert (seen >= ENOUGH).mean() > 0.7 and np.diff(field.path(goal), axis=0).any()
            walked = np.hypot(*np.diff(field.path(goal), axis=0).T).sum()
            assert walked <= field.length_to(goal) + 1e-9  # shortened, and not back into the blind middle
            assert field.path(goal)[:, 1].min() - grid.origin[1] < 5.0
    assert lowest[0] == lowest[1] > 5.9 and lowest[3] <= lowest[2] < 5.0  # a tenth of the way does not pay for a bend


def test_no_price_no_difference():
    rng = np.random.default_rng(3)
    grid = grid_of(random_cells(rng))
    start = centre(grid, *rng.choice(np.argwhere(grid.cells == FREE)))
    free = distance_field(grid, start, 0.2, sight=Sight(state_of(rng.normal(size=(5, 2))), REACH, 0.0))
    plain = distance_field(grid, start, 0.2)
    np.testing.assert_array_equal(free.costs, plain.costs)
    np.testing.assert_array_equal(free.steps, plain.steps)


def test_within_a_rectangle_features_outside_count_as_well():
    grid, features, start, goal = hall()
    within = np.concatenate([np.minimum(start, goal) - 2.0, np.maximum(start, goal) + 2.0])  # the features lie below
    field = distance_field(grid, start, 0.25, within, Sight(state_of(features), 5.0, 4.0))
    assert field.along(goal, 1.0)[:, 1].min() < start[1] - 0.9
