"""Visibility against Monte Carlo, against lines of sight drawn by hand, and against what it must never depend on."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from numba import typeof

from slam_gym.association.prediction import predict
from slam_gym.geometry import observe, transform
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.explored_grid import FREE, UNKNOWN, WALL, ExploredGrid
from slam_gym.navigation.visibility import NOTHING_EXPLORED, ViewsFrom, probabilities_in_view
from tests.oracles.densities import in_view
from tests.oracles.statistics import for_seeds, random_covariance

FULL = 2.0 * math.pi
NARROW = ViewsFrom(2.0, 5.0)


def grid_of(*rows, resolution=0.5):
    """A grid drawn as text, top row first: `.` free, `#` wall, `?` unknown."""
    grid = ExploredGrid(np.array([0.0, 0.0, len(rows[0]) * resolution, len(rows) * resolution]), resolution)
    kinds = {".": FREE, "#": WALL, "?": UNKNOWN}
    grid._cells[:] = [[kinds[letter] for letter in row] for row in reversed(rows)]
    return grid


@for_seeds(20)
def test_range_and_field_of_view_against_sampling(seed):
    """Along and across the line of sight taken for independent: exact for round covariances, close for others."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-7.0, 7.0, (8, 2))
    covariances = np.array([rng.uniform(0.01, 0.4) ** 2 * np.eye(2) for _ in range(8)])
    field, far, near = float(rng.uniform(0.5, FULL)), 6.0, 1.0
    got = in_view(ViewsFrom(field, far, near), positions, covariances)
    for position, P, probability in zip(positions, covariances, got):
        if np.hypot(*position) < 2.0:
            continue  # where the bearing is all but unknown, it is no longer normal
        drawn = rng.multivariate_normal(position, P, 4000)
        r, bearing = np.hypot(*drawn.T), np.arctan2(drawn[:, 1], drawn[:, 0])
        share = np.mean((r < far) & (r > near) & (np.abs(bearing) < field / 2))
        assert probability == pytest.approx(share, abs=0.04)


@for_seeds(10)
def test_without_uncertainty_it_is_the_test_itself(seed):
    rng = np.random.default_rng(seed)
    positions, field = rng.uniform(-8.0, 8.0, (50, 2)), float(rng.uniform(0.3, FULL))
    r, bearing = np.hypot(*positions.T), np.arctan2(positions[:, 1], positions[:, 0])
    expected = (r <= 6.0) & (r >= 0.5) & (np.abs(bearing) <= field / 2)
    got = in_view(ViewsFrom(field, 6.0, 0.5), positions, np.zeros((50, 2, 2)))
    assert got.tolist() == expected.astype(float).tolist()


ROOM = (
    "??????????????",
    "?############?",
    "?#.....#....#?",
    "?#.....#....#?",
    "?#.....#....#?",
    "?#..........#?",
    "?#..........#?",
    "?############?",
    "??????????????",
)


EXPLORED_ROOM = grid_of(*ROOM).explored


def seen_in_room(robot, target, explored=EXPLORED_ROOM):
    """Probability that a robot at `robot` (x, y, θ) sees `target` (x, y), both in cells of ROOM from its lower left."""
    pose = np.array([0.5 * robot[0], 0.5 * robot[1], robot[2]])
    position = observe(pose, 0.5 * np.array([target], float))
    return float(in_view(ViewsFrom(FULL, 20.0, explored=explored), position, 1e-6 * np.eye(2)[None], pose)[0])


@pytest.mark.parametrize("heading", [0.0, 1.3, -2.9])
def test_walls_hide_what_lies_behind_them(heading):
    assert seen_in_room((3.5, 5.5, heading), (10.5, 5.5)) == 0.0
    assert seen_in_room((3.5, 5.5, heading), (10.5, 5.5), NOTHING_EXPLORED) == 1.0
    assert seen_in_room((3.5, 3.0, heading), (10.5, 3.0)) == 1.0  # through the opening
    assert seen_in_room((3.5, 5.5, heading), (7.5, 5.5)) == 1.0  # on the wall itself
    assert seen_in_room((3.5, 5.5, heading), (3.5, 1.5)) == 1.0
    assert 0.0 < seen_in_room((3.5, 3.2, heading), (10.5, 3.9)) < 1.0  # grazing the end of the wall


def test_unknown_space_lets_through_by_its_length():
    grid = ExploredGrid(np.array([0.0, 0.0, 10.0, 10.0]), 0.1)
    pose, position, tight = np.array([1.0, 5.0, 0.0]), np.array([[4.2, 0.0]]), 1e-12 * np.eye(2)[None]
    for unknown in (0.0, 0.5, 0.9, 1.0):
        got = in_view(ViewsFrom(FULL, 6.0, unknown=unknown, explored=grid.explored), position, tight, pose)[0]
        assert got == pytest.approx(unknown**4.0, abs=2e-3)  # 4.2 m less the two cells at the end
    grid._cells[:, :30] = FREE
    got = in_view(ViewsFrom(FULL, 6.0, unknown=0.5, explored=grid.explored), position, tight, pose)[0]
    assert got == pytest.approx(0.5**2.0, abs=2e-3)


@for_seeds(30)
def test_walls_only_ever_hide_and_a_turn_of_everything_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    grid = ExploredGrid(np.array([0.0, 0.0, 8.0, 8.0]), 0.2)
    grid._cells[:] = rng.choice(
        [UNKNOWN, FREE, FREE, FREE, FREE, FREE, WALL], grid.cells.shape, p=[0.1] + [0.16] * 5 + [0.1]
    )
    pose = np.array([*rng.uniform(0.0, 8.0, 2), rng.uniform(-math.pi, math.pi)])
    features = rng.uniform(0.0, 8.0, (20, 2))
    covariances = np.array([random_covariance(rng, 2, 0.1) for _ in range(20)])
    got = in_view(replace(NARROW, explored=grid.explored), observe(pose, features), covariances, pose)
    free = in_view(NARROW, observe(pose, features), covariances)
    assert (got >= 0.0).all() and (got <= free).all() and (got < free).any()
    # a quarter turn of grid, robot and features together
    turned = ExploredGrid(np.array([-8.0, 0.0, 0.0, 8.0]), 0.2)
    turned._cells[:] = np.rot90(grid.cells[::-1])[::-1]
    quarter = np.array([0.0, 0.0, math.pi / 2])
    moved = np.array([*transform(quarter, pose[None, :2])[0], pose[2] + math.pi / 2])
    there = replace(NARROW, explored=turned.explored)
    again = in_view(there, observe(moved, transform(quarter, features)), covariances, moved)
    assert np.abs(again - got).max() < 0.25 and np.median(np.abs(again - got)) < 1e-6  # but for rays along borders


BAD = [{"angle": 0.0}, {"angle": 7.0}, {"angle": math.nan}, {"range": math.inf}, {"range": 1.0, "min_range": 2.0}]


@pytest.mark.parametrize("options", [*BAD, {"unknown": 1.5}])
def test_bad_fields_of_view_are_named(options):
    with pytest.raises(ValueError, match=f"ViewsFrom.{next(iter(options))}"):
        ViewsFrom(**{"angle": 2.0, "range": 5.0} | options)


def test_a_feature_with_invalid_numbers_has_no_probability():
    places, spread = np.array([[math.nan, 0.0], [1.0, 0.0]]), np.tile(np.eye(2), (2, 1, 1))
    found = probabilities_in_view(places, spread, NARROW.arrays, np.zeros(3))
    assert math.isnan(found[0]) and 0.0 < found[1] < 1.0
    assert np.isnan(probabilities_in_view(places, -spread, NARROW.arrays, np.zeros(3))).all()


@pytest.mark.parametrize("sigma", [1e3, 1e6, 1e12])
def test_a_ray_that_has_left_the_grid_for_good_ends_there_however_far_it_goes(sigma):
    """What is outside is unknown: with τ = 1 to whatever lies there nothing is hidden, else everything is."""
    grid, here = grid_of("...").explored, np.array([0.3, 0.1, 0.0])
    at, spread = np.array([[2.0, 0.0]]), np.diag([1.0, sigma**2])[None]
    for unknown in (1.0, 0.5):
        view = ViewsFrom(2.0 * math.pi, 6.0, unknown=unknown)
        beside, through = in_view(view, at, spread)[0], in_view(replace(view, explored=grid), at, spread, here)[0]
        assert through == pytest.approx(beside) if unknown == 1.0 else 0.0 <= through < beside


def test_explored_cells_can_be_looked_at_but_not_changed():
    grid = grid_of("...")
    for array in (grid.explored.cells, grid.explored.origin):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = WALL


def test_loops_are_compiled_once_for_predictions_with_and_without_a_view():
    views = NARROW, replace(NARROW, explored=grid_of("...").explored)
    made = [predict(StochasticMap(), 5.0, sight=view) for view in (None, *views)]
    assert len({typeof(prediction.arrays) for prediction in [*made, pickle.loads(pickle.dumps(made[2]))]}) == 1
