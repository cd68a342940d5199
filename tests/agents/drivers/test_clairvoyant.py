"""The upper reference: it needs the truth, keeps to the goals on offer, and maps more than those who do not know."""

import itertools

import numpy as np
import pytest

from agents.drivers.base import make_agent
from agents.drivers.baselines import NearestFrontier
from agents.drivers.clairvoyant import Clairvoyant, TrueViews, best_tour, bits_of
from agents.evaluation.episodes import ExploreArguments, begin_episode, run_episode
from slam_gym.scenarios import get_scenario, world_generator
from slam_gym.simulation.episode import survey
from slam_gym.world.ray_casting import NOTHING, pull_back, seen_from
from tests.agents.drivers import offered

SMALL = ExploreArguments("office-small", (("budget", 200),), split="train")


def test_it_maps_more_than_the_nearest_frontier():
    env, errors = SMALL.make("goal"), {}
    for agent in (Clairvoyant(), NearestFrontier()):
        errors[agent.name] = sum(run_episode(env, agent, k)["map_error"] for k in range(4))
    assert errors["clairvoyant"] < 0.9 * errors["nearest_frontier"]


def test_values_promise_no_more_than_there_is():
    env, agent = SMALL.make("goal"), Clairvoyant()
    observation, info = begin_episode(env, agent, 0)
    values, missing = agent.values(observation, info), int(env.unwrapped.episode.site.observable.sum())
    legal = info["action_mask"]
    assert np.isneginf(values[~legal]).all()
    assert (values[legal] >= 0.0).all() and values[legal].max() <= 1.2 * missing


class Curious(NearestFrontier):
    """Would like to be shown the truth as well."""

    shown = None

    def behold(self, episode):
        self.shown = episode


def test_nobody_else_is_shown_the_truth():
    env, curious = SMALL.make("goal"), Curious()
    begin_episode(env, curious, 0)
    assert curious.shown is None
    with pytest.raises(RuntimeError, match="behold"):
        make_agent("clairvoyant").act(*offered())


# -- what is seen from where, and on the way: against the sight lines of the world itself ------------------------------

SCENARIO = get_scenario("office-small")


def members(bits):
    """The features of a set, as Python has them."""
    return {64 * w + b for w, word in enumerate(bits.tolist()) for b in range(64) if word >> b & 1}


@pytest.fixture(scope="module")
def site():
    return survey(SCENARIO.generator(world_generator("train", 0)), SCENARIO)


@pytest.fixture(scope="module")
def views(site):
    return TrueViews(site, SCENARIO.sensor.range)


def test_from_a_cell_is_seen_what_counts_is_near_and_no_wall_hides(site, views):
    features = site.plan.features
    for cell in np.random.default_rng(0).choice(len(site.cells), 20, replace=False):
        gaps = np.hypot(*(features.positions - site.cells[cell]).T)
        free = seen_from(site.index, site.cells[[cell]], features.positions, pull_back(features), np.inf, NOTHING)
        expected = np.flatnonzero((gaps <= 0.95 * SCENARIO.sensor.range) & free & site.observable)
        assert members(views.seen[cell]) == set(expected)


# -- tours against all sequences of a few viewpoints -------------------------------------------------------------------


def problem(rng, viewpoints=4, features=90):
    """Legs with views between some places of a square, the last of which is the start."""
    places = rng.uniform(0.0, 100.0, (viewpoints + 1, 2))
    ticks = np.hypot(*(places[:, None] - places).transpose(2, 0, 1)) + 30.0
    legs = np.array([[bits_of(rng.random(features) < 0.1) for _ in ticks] for _ in ticks])
    return ticks, legs, rng.uniform(-0.2, 1.0, features)


def brute_force(ticks, legs, left, seen, worth):
    """The most that any sequence of viewpoints brings; there is time for five at most."""
    start, best = len(ticks) - 1, 0.0
    for count in range(1, 6):
        for order in itertools.product(range(start), repeat=count):
            route = list(itertools.pairwise((start, *order)))
            if sum(ticks[leg] for leg in route) <= left:
                found = set().union(*(members(legs[leg]) for leg in route)) - members(seen)
                best = max(best, sum(worth[i] for i in found))
    return best


def tour(ticks, legs, left, seen, worth, chance, early=0.0):
    n = len(ticks) - 1
    inner = np.ascontiguousarray(ticks[:n, :n]), np.ascontiguousarray(legs[:n, :n])
    return best_tour((ticks[n, :n].copy(), legs[n, :n].copy()), inner, left, seen, worth, chance, early)


def test_no_tour_brings_more_than_the_best_sequence_and_many_come_near_it():
    rng, reached, best = np.random.default_rng(1), 0.0, 0.0
    for _ in range(8):
        ticks, legs, worth = problem(rng)
        left, seen = float(rng.uniform(60.0, 180.0)), bits_of(rng.random(90) < 0.2)
        chance = np.exp(0.6 * rng.standard_normal((200, len(ticks) - 1)))
        found, most = tour(ticks, legs, left, seen, worth, chance), brute_force(ticks, legs, left, seen, worth)
        assert found <= most + 1e-9
        reached, best = reached + found, best + most
    assert reached > 0.97 * best
