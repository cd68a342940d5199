"""Where the robot can go and what it can see from there, on plans whose answer is known."""

import numpy as np
import pytest

from slam_gym.world.floor_plan import Features, FloorPlan, Room
from slam_gym.world.ray_casting import NOTHING, box_distance, cast, outlines, pull_back, seen_from, wall_index
from slam_gym.world.reachability import free_cells, free_start, observable, reachable

NO_FEATURES = Features(np.empty((0, 2)), np.empty(0), np.empty(0))


def rectangle(x1, y1, x2, y2):
    return [(x1, y1, x2, y1), (x2, y1, x2, y2), (x2, y2, x1, y2), (x1, y2, x1, y1)]


def room(name, x1, y1, x2, y2):
    return Room(name, [(x1, y1), (x2, y1), (x2, y2), (x1, y2)])


def two_rooms(gap, features=NO_FEATURES, furniture=()):
    """6 × 5 m and 4 × 5 m, with an opening of width `gap` [m] in the wall between them."""
    low, high = 2.5 - gap / 2, 2.5 + gap / 2
    middle = [(6, 0, 6, low), (6, high, 6, 5)] if gap else [(6, 0, 6, 5)]
    rooms = (room("large", 0, 0, 6, 5), room("small", 6, 0, 10, 5))
    return FloorPlan("two rooms", rectangle(0, 0, 10, 5) + middle, features, rooms, (), furniture)


def test_all_free_cells_of_a_room_and_nothing_else():
    plan = FloorPlan("room", rectangle(0, 0, 6, 4), NO_FEATURES, (room("room", 0, 0, 6, 4),))
    cells = reachable(plan, free_cells(plan, 0.3, 0.2))
    assert np.all((cells >= 0.3 - 1e-9) & (cells <= np.array([6, 4]) - 0.3 + 1e-9))
    assert len(cells) * 0.2**2 == pytest.approx(5.4 * 3.4, rel=0.1)
    assert len(np.unique(np.round(cells / 1e-6), axis=0)) == len(cells)


@pytest.mark.parametrize(("gap", "width"), [(0.9, 10), (0.7, 10), (0.35, 6), (0.0, 6)])
def test_the_robot_fits_through_a_door_or_stays_in_the_larger_room(gap, width):
    plan = two_rooms(gap)
    cells = reachable(plan, free_cells(plan, 0.2))
    assert cells[:, 0].min() < 0.5 and width - 0.5 < cells[:, 0].max() < width


@pytest.mark.parametrize("radius", [0.2, 0.5])
def test_the_ground_around_a_building_never_counts(radius):
    """An L-shaped building within a far larger fence-less ground, with and without rooms that say what is inside."""
    corners = np.array([[0, 0], [30, 0], [30, 2], [2, 2], [2, 30], [0, 30]], float)
    walls = np.hstack([corners, np.roll(corners, -1, axis=0)])
    with_rooms = FloorPlan("L", walls, NO_FEATURES, (Room("L", corners),))
    without = FloorPlan("L", walls, NO_FEATURES)
    cells, same = (reachable(plan, free_cells(plan, radius)) for plan in (without, with_rooms))
    np.testing.assert_array_equal(same, cells)
    assert Room("L", corners).contains(cells).all() and len(cells) * 0.25**2 > 100 * (1 - radius)


def test_a_disc_can_move_straight_between_neighbouring_cells():
    """No wall lies closer to the way between two free neighbours than cell geometry allows: none is ever crossed."""
    rng = np.random.default_rng(0)
    start = rng.uniform(0, 12, (60, 2))
    plan = FloorPlan("clutter", np.hstack([start, start + rng.normal(size=(60, 2))]), NO_FEATURES)
    index = wall_index(plan.walls)
    for radius in (0.05, 0.2):
        cells = free_cells(plan, radius)
        assert cells.cell < 2 * radius
        centres = cells.centres(np.arange(cells.free.size)).reshape(*cells.free.shape, 2)
        for here, there in ((np.s_[:-1, :], np.s_[1:, :]), (np.s_[:, :-1], np.s_[:, 1:])):
            both = cells.free[here] & cells.free[there]
            for a, b in zip(centres[here][both][::7], centres[there][both][::7]):
                assert seen_from(index, a[None], b[None], np.zeros(1), np.inf, NOTHING)[0]


def test_nothing_is_reachable_where_nothing_is_free():
    plan = FloorPlan("crack", rectangle(0, 0, 5, 0.3), NO_FEATURES, (room("crack", 0, 0, 5, 0.3),))
    cells = reachable(plan, free_cells(plan, 0.2))
    assert cells.shape == (0, 2)
    with pytest.raises(ValueError, match="'crack' has no free space"):
        free_start(plan, cells, 0.2, np.random.default_rng(0))


def test_features_can_be_observed_from_reachable_cells_only():
    positions = np.array([[0, 0], [6, 2.05], [10, 5], [8, 0], [3, 2.5]], float)
    features = Features(positions, [0, 1, 0, 0, 2], [1, 0.9, 1, 1, 0.3])
    for gap, expected in ((0.9, [True, True, True, True, True]), (0.0, [True, True, False, False, True])):
        plan = two_rooms(gap, features)
        index = wall_index(plan.walls)
        cells = reachable(plan, free_cells(plan, 0.2))
        seen = observable(plan, index, cells, 6.0)
        np.testing.assert_array_equal(seen, expected)
        back = pull_back(features)
        one_by_one = np.zeros(5, bool)
        for cell in cells:
            near = np.hypot(*(positions - cell).T) <= 6.0
            one_by_one |= near & seen_from(index, cell[None], positions, back, np.inf, NOTHING)
        np.testing.assert_array_equal(seen, one_by_one)
    assert not observable(plan, index, cells[:1], 0.5).any(), "out of range"
    assert not observable(plan, index, cells[:0], 6.0).any(), "no cell to see from"


@pytest.mark.parametrize(("radius", "distance"), [(0.2, 0.3), (0.4, 0.45)])
def test_starts_are_free_of_walls_and_furniture_and_cover_the_floor(radius, distance):
    furniture = np.array([[3.0, 2.5, 2.0, 0.8, 0.4], [8.0, 1.0, 0.6, 0.6, 0.0]])
    plan, rng = two_rooms(1.2, furniture=furniture), np.random.default_rng(4)
    cells = reachable(plan, free_cells(plan, radius))
    starts = np.array([free_start(plan, cells, radius, rng) for _ in range(300)])
    index = wall_index(np.vstack([plan.walls, outlines(furniture)]))
    angles = np.linspace(-np.pi, np.pi, 120)
    for start in starts:
        assert cast(index, start[:2], angles, 3.0, NOTHING).min() >= radius - 1e-9
        assert box_distance(start[0], start[1], furniture) >= distance
    assert (starts[:, 0] > 6).mean() == pytest.approx(0.4, abs=0.1), "cells are equally likely"
    assert np.abs(starts[:, 2]).max() > 3.0 and np.abs(starts[:, 2]).min() < 0.1
    again = free_start(plan, cells, radius, np.random.default_rng(8))
    np.testing.assert_array_equal(free_start(plan, cells, radius, np.random.default_rng(8)), again)


@pytest.mark.parametrize(("radius", "cell"), [(0.0, 0.25), (np.nan, 0.25), (0.2, 0.0), (0.2, np.inf)])
def test_lengths_that_are_none_are_refused(radius, cell):
    with pytest.raises(ValueError, match="radius and cell must be positive"):
        free_cells(two_rooms(0.9), radius, cell)
