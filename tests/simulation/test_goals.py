"""The goals on offer: what they say, how places are remembered, and what a revisit promises."""

import math

import numpy as np
import pytest

from slam_gym.navigation.active_slam import features_in_sight
from slam_gym.navigation.explored_grid import FREE, UNKNOWN, WALL, ExploredGrid
from slam_gym.navigation.frontiers import frontiers
from slam_gym.navigation.planner import distance_field
from slam_gym.simulation import goals
from slam_gym.simulation.goals import FRONTIERS, LOOK, PLACE_SPACING, REVISITS, WORTH_SEEING, Places, Tried
from tests.rollouts import SCENARIOS, episode, explore

FIRST_REVISIT = 1 + FRONTIERS


def decisions(scenario: str, steps: int = 8, seed: int = 0):
    """(env, its goals) at each decision of a random episode."""
    env = explore(scenario)
    for _ in episode(env, steps, seed=seed):
        yield env, env.goals


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_goals_are_what_they_say(scenario) -> None:
    frontiers = revisits = 0
    for env, offer in decisions(scenario):
        slam_map, grid, scene = env.episode.slam.map, env.episode.grid, env.scenario
        field = distance_field(grid, slam_map.pose[:2], scene.robot.radius + goals.CLEARANCE)
        ends, back = offer.legal[1:FIRST_REVISIT].sum(), offer.legal[FIRST_REVISIT:].sum()
        frontiers, revisits = frontiers + ends, revisits + back
        assert offer.legal[: 1 + ends].all() and offer.legal[FIRST_REVISIT : FIRST_REVISIT + back].all()  # no gaps
        np.testing.assert_array_equal(offer.positions[LOOK], slam_map.pose[:2])
        for slot in np.flatnonzero(offer.legal)[1:]:
            assert offer.lengths[slot] == field.lengths_to(offer.positions[slot : slot + 1])[0] < math.inf
            assert len(field.path(offer.positions[slot])) >= 2
        np.testing.assert_array_equal(
            offer.areas[offer.legal], grid.expected_area(offer.positions[offer.legal], scene.beams.range)
        )
        assert (offer.areas[1 : 1 + ends] >= WORTH_SEEING).all()
        assert (np.diff(offer.lengths[1 : 1 + ends]) >= 0.0).all()
        here = features_in_sight(slam_map.mean, grid, slam_map.pose[None, :2], scene.sensor.range)[0]
        assert offer.in_view[LOOK] == pytest.approx(scene.sensor.field_of_view / math.tau * here)
        assert (offer.reductions >= 0.0).all() and np.isfinite(offer.reductions).all()
        for values in (offer.positions, offer.lengths, offer.areas, offer.reductions):
            assert not values[~offer.legal].any()
    assert frontiers > 5 and revisits > 0


@pytest.mark.parametrize("scenario", ["office", "hall"])
def test_revisits_are_places_passed_apart_from_each_other_and_best_per_metre_first(scenario) -> None:
    most = 0
    for env, offer in decisions(scenario, 12):
        slots = FIRST_REVISIT + np.flatnonzero(offer.legal[FIRST_REVISIT:])
        spots = offer.positions[slots]
        been = np.array(env.episode.estimates)[:, :2]
        for i, spot in enumerate(spots):
            assert np.hypot(*(been - spot).T).min() == 0.0
            assert all(np.hypot(*(spot - other)) >= 3.0 for other in spots[:i])
        assert (offer.lengths[slots] > PLACE_SPACING).all()
        worth = offer.reductions[slots] / (offer.lengths[slots] + 1.0)
        assert (np.diff(worth) <= 0.0).all()
        most = max(most, len(slots))
    assert 2 <= most <= REVISITS


def test_places_are_thinned_out_and_the_first_and_the_last_are_kept() -> None:
    places = Places()
    assert places.candidates().shape == (0, 2)
    way = np.stack([np.arange(0.0, 200.0, 0.1), np.zeros(2000)], axis=1)
    for position in way:
        places.pass_by(position)
        places.pass_by(position + 0.05)
    candidates = places.candidates()
    assert 20 <= len(candidates) <= 32
    np.testing.assert_array_equal(candidates[0], [0.0, 0.0])
    assert candidates[-1, 0] > 200.0 - 2 * PLACE_SPACING
    assert (np.diff(candidates[:, 0]) >= PLACE_SPACING).all()


def corridor(pockets: int = 14) -> ExploredGrid:
    """A corridor of 60 m that ends in the unknown, with as many nooks off it into which nobody has looked yet."""
    grid = ExploredGrid(np.array([0.0, 0.0, 90.0, 12.0]))
    cells = grid._layers[0]
    cells[9:31, :310] = WALL
    cells[10:20, 1:300] = FREE
    for k in range(pockets):
        cells[20:27, 10 + 18 * k : 17 + 18 * k] = UNKNOWN
    cells[:, 300:] = UNKNOWN
    return grid


def ends_of(grid: ExploredGrid, tried: Tried | None = None) -> np.ndarray:
    field = distance_field(grid, np.array([1.5, 3.0]), 0.25)
    return goals.frontiers_on_offer(grid, field, 6.0, tried or Tried())


def test_the_far_end_is_on_offer_whatever_nooks_are_nearer() -> None:
    grid = corridor()
    found = frontiers(grid, distance_field(grid, np.array([1.5, 3.0]), 0.25).reachable)
    assert len(found) > FRONTIERS and found[:, 0].max() > 59.0
    ends = ends_of(grid)
    assert len(ends) == FRONTIERS and ends[-1, 0] > 59.0 and (np.diff(ends[:, 0]) > 0.0).all()
    few = ends_of(corridor(pockets=5))
    assert len(few) == 6 and few[-1, 0] > 59.0


def test_frontiers_tried_in_vain_make_room_for_others_until_there_are_none() -> None:
    grid, tried = corridor(pockets=3), Tried()
    first = ends_of(grid)
    tried.add(first[0])
    np.testing.assert_array_equal(ends_of(grid, tried), first)
    tried.add(first[0] + np.array([0.3, 0.0]))
    np.testing.assert_array_equal(ends_of(grid, tried), first[1:])
    for end in first[1:]:
        for _ in range(3):
            tried.add(end)
    np.testing.assert_array_equal(ends_of(grid, tried), first[:1])  # the least often tried
    tried.add(first[0])
    np.testing.assert_array_equal(ends_of(grid, tried), first)
