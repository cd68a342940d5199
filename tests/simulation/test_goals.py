"""The goals on offer: what they say, how places are remembered, and what a revisit promises."""

import math

import numpy as np
import pytest

from slam_gym.navigation.expected_gain import expected_reduction
from slam_gym.navigation.planner import distance_field
from slam_gym.simulation import goals
from slam_gym.simulation.goals import FRONTIERS, LOOK, PLACE_SPACING, REVISITS, WORTH_SEEING, Places
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
            assert offer.lengths[slot] == field.length_to(offer.positions[slot]) < math.inf
            assert len(field.path(offer.positions[slot])) >= 2
        np.testing.assert_array_equal(
            offer.areas[offer.legal], grid.expected_area(offer.positions[offer.legal], scene.beams.range)
        )
        assert (offer.areas[1 : 1 + ends] >= WORTH_SEEING).all()
        assert (np.diff(offer.lengths[1 : 1 + ends]) >= 0.0).all()
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


def test_the_promised_reduction_is_that_of_the_foreseen_update() -> None:
    *_, (env, offer) = decisions("office", 6)
    ep, sensor = env.episode, env.scenario.sensor
    sigma = math.hypot(sensor.range_sigma, sensor.bearing_sigma * sensor.range / 2.0) / math.sqrt(5.0)
    drift = np.array([0.03, 0.03, 0.02])
    again = expected_reduction(
        ep.slam.map.mean,
        ep.slam.map.covariance,
        ep.grid,
        offer.positions[offer.legal],
        reach=6.0,
        sigma=sigma,
        drift=drift,
    )
    np.testing.assert_allclose(offer.reductions[offer.legal], again, rtol=1e-12)


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
