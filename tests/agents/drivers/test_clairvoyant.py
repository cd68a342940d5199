"""The upper reference: it needs the truth, keeps to the goals on offer, and maps more than those who do not know."""

import numpy as np
import pytest

from agents.drivers.base import make_agent
from agents.drivers.clairvoyant import Clairvoyant
from agents.drivers.nearest_frontier import NearestFrontier
from agents.evaluation.episodes import ExploreArguments, begin_episode, run_episode
from tests.agents.drivers import offered

SMALL = ExploreArguments("office-small", (("budget", 200),), split="train")


def test_without_the_truth_there_is_no_telling():
    with pytest.raises(RuntimeError, match="behold"):
        make_agent("clairvoyant").act(*offered())


def test_it_maps_more_than_the_nearest_frontier():
    env, errors = SMALL.make("goal"), {}
    for agent in (Clairvoyant(), NearestFrontier()):
        errors[agent.name] = sum(run_episode(env, agent, k)["map_error"] for k in range(4))
    assert errors["clairvoyant"] < 0.9 * errors["nearest_frontier"]


def test_values_promise_no_more_than_there_is_and_nothing_once_all_is_mapped():
    env, agent = SMALL.make("goal"), Clairvoyant()
    observation, info = begin_episode(env, agent, 0)
    values, missing = agent.values(observation, info), int(env.unwrapped.episode.site.observable.sum())
    legal = info["action_mask"]
    assert np.isneginf(values[~legal]).all()
    assert (values[legal] >= 0.0).all() and values[legal].max() <= 1.2 * missing
    agent._known = lambda: ~np.zeros_like(agent._views.seen[0])
    assert (agent.values(observation, info)[legal] == 0.0).all()


class Curious(NearestFrontier):
    """Would like to be shown the truth as well."""

    shown = None

    def behold(self, episode):
        self.shown = episode


class Heir(Clairvoyant):
    shown = None

    def behold(self, episode):
        self.shown = episode


def test_nobody_else_is_shown_the_truth():
    env, curious, heir = SMALL.make("goal"), Curious(), Heir()
    begin_episode(env, curious, 0)
    assert curious.shown is None
    begin_episode(env, heir, 0)
    assert heir.shown is env.unwrapped.episode
