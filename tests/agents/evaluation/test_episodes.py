"""Episodes that agree with themselves, whoever watches; arguments that the environments take."""

import numpy as np
import pytest

from agents.drivers.base import make_agent
from agents.evaluation.episodes import AssociateArguments, ExploreArguments, associate_episode, map_lost, run_episode
from tests.agents.evaluation import timeless

SMALL = ExploreArguments("office-small")


@pytest.fixture(scope="module")
def record():
    return run_episode(SMALL.make("goal"), make_agent("random"), 1)


def test_a_record_agrees_with_itself(record):
    curve = record["curve"]
    assert len(curve["ticks"]) == len(curve["map_error"]) == len(curve["coverage"])
    assert np.all(np.diff(curve["ticks"]) > 0) and curve["ticks"][-1] == record["ticks"] == 300
    assert record["map_error"] == pytest.approx(curve["map_error"][-1], abs=1e-5)
    assert record["return"] == pytest.approx(curve["map_error"][0] - curve["map_error"][-1], abs=1e-5)


def test_watching_an_episode_does_not_change_it(record):
    seen = []
    env = SMALL.make("goal")
    watched = run_episode(env, make_agent("random"), 1, watch=lambda e: seen.append(e.unwrapped.episode.ticks))
    assert seen == list(range(1, 301))
    assert timeless([watched]) == timeless([record])


def test_arguments_are_those_of_the_environment_and_hashable():
    changed = ExploreArguments("office-small", (("sensor.range", 4.0), ("budget", 20)))
    env = changed.make("twist")
    assert (env.unwrapped.scenario.sensor.range, env.unwrapped.scenario.budget) == (4.0, 20)
    assert changed.plain["overrides"] == {"sensor.range": 4.0, "budget": 20} and hash(changed) != hash(SMALL)
    assert ExploreArguments("clutter/1").make("goal").unwrapped.scenario.sensor.clutter == 3.0
    with pytest.raises(ValueError, match=r"sensor\.rang.*range"):
        ExploreArguments("office-small", (("sensor.rang", 4.0),)).make("goal")


def test_an_episode_of_decisions_ends_with_its_score():
    env = AssociateArguments("corridor", split="test").make()
    record = associate_episode(env, lambda observation, mask: int(np.flatnonzero(mask)[0]), 0)
    assert record["decisions"] > 100 and np.isfinite([record["score"], record["map_error"], record["return"]]).all()


def test_a_map_is_lost_by_its_error_or_by_its_duplicates():
    assert map_lost(0.81, 0.0) == map_lost(0.1, 11.0) == 1.0 and map_lost(0.8, 10.0) == 0.0
