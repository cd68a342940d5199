"""A drive in outline: near enough to an episode, the same each time, and forked without a trace."""

import numpy as np
import pytest

from agents.drivers.base import LOOK_AROUND
from agents.drivers.information_gain import InformationGain
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.learning.driver.examples import policy_of
from agents.learning.driver.sketch import QUARTER, Sketch, played
from slam_gym.simulation.goals import FRONTIERS

GREEDY = policy_of(None)


@pytest.fixture(scope="module")
def env():
    return ExploreArguments("office-small", split="train").make("goal")


def begun(env, world, budget=300):
    env.reset(seed=world, options={"world": world})
    return Sketch(env.unwrapped.episode, budget)


def test_it_misses_about_what_an_episode_misses(env):
    outline = [played(begun(env, world), GREEDY) for world in range(6)]
    full = []
    for world in range(6):
        run_episode(env, InformationGain(), world)
        episode = env.unwrapped.episode
        mapped = np.concatenate([part.ids[~part.provisional] for part in episode.slam.maps])
        found = np.isin(np.flatnonzero(episode.site.observable), episode.identities.source_of(mapped))
        full.append(1.0 - found.mean())
    assert -0.12 < np.mean(outline) - np.mean(full) < 0.04  # a robot in outline stops and turns less, and sees at once


def test_what_is_seen_stays_and_the_budget_ends_the_drive(env):
    sketch, missed = begun(env, 1, 200), [1.0]
    while not sketch.over:
        before, legal = sketch.ticks, sketch.legal
        assert legal.any() and not legal[1 + FRONTIERS :].any()
        slot = GREEDY(sketch)
        assert legal[slot]
        sketch.step(slot)
        assert sketch.ticks > before
        missed.append(sketch.missed)
    assert (np.diff(missed) <= 0.0).all() and missed[-1] < 0.7 and sketch.ticks < 200 + 3 * QUARTER


def test_a_fork_goes_on_as_the_drive_itself_would_have_and_leaves_it_alone(env):
    sketch = begun(env, 2)
    sketch.step(GREEDY(sketch))
    shown, missed, ticks = sketch.observation(), sketch.missed, sketch.ticks
    slots = np.flatnonzero(sketch.legal)
    ends = [played(sketch.fork(), GREEDY, int(k)) for k in slots]
    after = sketch.observation()
    assert (sketch.missed, sketch.ticks) == (missed, ticks) and all(np.array_equal(shown[k], after[k]) for k in shown)
    assert ends == [played(sketch.fork(), GREEDY, int(k)) for k in slots] and len(set(ends)) > 1
    chosen = GREEDY(sketch)
    assert played(sketch, GREEDY) == ends[list(slots).index(chosen)]


def test_nobody_looks_around_twice_at_one_place(env):
    sketch = begun(env, 3)
    assert sketch.legal[LOOK_AROUND]
    sketch.step(LOOK_AROUND)
    assert sketch.ticks == 4 * QUARTER and not sketch.legal[LOOK_AROUND]


def test_among_people_a_feature_must_be_in_sight_for_longer(env):
    crowd = ExploreArguments("crowd", split="train").make("goal")
    one, several = begun(env, 4), begun(crowd, 4, 300)
    assert one.missed < 1.0 and several.missed == 1.0  # after the first look
    several.step(LOOK_AROUND)
    assert several.missed < 1.0
