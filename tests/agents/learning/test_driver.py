"""The training of the learned driver: drives in outline, what is learned from them, and the weights that come of it."""

import numpy as np
import pytest
import torch

from agents.drivers.baselines import InformationGain
from agents.drivers.learned import SHAPES, TOKEN_FIELDS, LearnedDriver, Tokens, load_driver, scores, tokens_of
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.learning.driver import (
    DriverPlan,
    Examples,
    greedy,
    loss_of,
    regret_of,
    reproduce,
    sketched_drive,
    trained,
    untrained,
)
from agents.learning.sketch import Sketch, missed_by
from slam_gym.weights import write
from tests.agents.drivers.test_learned import some_tokens

SHORT = DriverPlan(epochs=12, batch=32, rate=3e-3)


@pytest.fixture(scope="module")
def env():
    return ExploreArguments("office-small", split="train").make("goal")


def begun(env, world, budget=300):
    env.reset(seed=world, options={"world": world})
    return Sketch(env.unwrapped.episode, budget)


# -- drives in outline -------------------------------------------------------------------------------------------------


def test_an_outline_misses_about_what_an_episode_misses(env):
    outline, full = [], []
    for world in range(6):
        sketch = begun(env, world)
        outline.append(missed_by(sketch, greedy, greedy(sketch)))
        run_episode(env, InformationGain(), world)
        episode = env.unwrapped.episode
        mapped = np.concatenate([part.ids[~part.provisional] for part in episode.slam.maps])
        found = np.isin(np.flatnonzero(episode.site.observable), episode.identities.source_of(mapped))
        full.append(1.0 - found.mean())
    assert -0.12 < np.mean(outline) - np.mean(full) < 0.04  # a robot in outline stops and turns less, and sees at once


# -- what is learned from them -----------------------------------------------------------------------------------------


def test_a_drive_gives_the_same_states_each_time_and_what_is_mapped_in_the_end(env):
    (world, one), (_, two) = (sketched_drive("office-small", 7) for _ in range(2))
    assert world == 7 and all(np.array_equal(a, b) for a, b in zip(one, two))
    assert (one.values[~one.legal] == 0.0).all() and (one.values[one.legal] > 0.0).all() and one.values.max() <= 100.0
    assert (one.legal.sum(axis=1) > 1).all() and len(one) == len(one.fields) > 1
    sketch = begun(env, 7, int(300 * np.random.default_rng(7).uniform(0.45, 1.1)))
    rows, tokens = tokens_of(sketch.observation(), sketch.ticks, sketch.legal)
    assert all(np.array_equal(part[0], own) for part, own in zip(one, tokens)) and rows[0] == greedy(sketch)
    for k in np.flatnonzero(one.legal[0]):
        assert one.values[0, k] == 100.0 * (1.0 - missed_by(sketch, greedy, int(rows[k])))


def test_torch_gives_the_same_scores_and_an_untrained_network_is_greedy():
    rng, tokens = np.random.default_rng(0), some_tokens()
    start = untrained(rng)
    assert {name: array.shape for name, array in start.items()} == SHAPES
    assert np.allclose(scores(start, tokens), 3.0 * tokens.greedy)
    drawn = {name: rng.normal(0.0, 0.3, array.shape) for name, array in start.items()}
    many = {name: torch.as_tensor(array) for name, array in drawn.items()}
    batch = Tokens(*(torch.as_tensor(np.stack([part, part])) for part in tokens))
    assert np.allclose(scores(many, batch, torch), scores(drawn, tokens))


def states(n, seed, goals=6):
    """A teacher who likes what the first field says, and dislikes goals that lie among others."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 4.0, (n, goals))
    gaps = np.abs(places[:, :, None] - places[:, None])
    tokens = rng.normal(size=(n, goals, len(TOKEN_FIELDS)))
    legal = rng.random((n, goals)) < 0.8
    legal[:, 0] = True
    values = 2.0 * tokens[..., 0] - np.where(legal[:, None], gaps < 0.5, False).sum(axis=2)
    return Examples(tokens, gaps, 0.3 * rng.normal(size=(n, goals)) - 1.0, legal, np.where(legal, values, 0.0))


def test_only_differences_between_legal_goals_of_a_state_count():
    batch = states(20, 0).batch(np.arange(20))
    scored, by_state = torch.randn(20, 6), torch.arange(20.0)[:, None]
    torch.testing.assert_close(loss_of(scored + by_state, batch), loss_of(scored, batch))
    torch.testing.assert_close(loss_of(batch.values + by_state, batch), torch.tensor(0.0))


def test_it_learns_to_choose_what_the_teacher_values_and_the_same_each_time():
    train, held_out = states(400, 0), states(200, 1)
    (network, curve), (again, _) = (trained(SHORT, train, held_out, 0) for _ in range(2))
    assert all(np.array_equal(network[name], again[name]) for name in network)
    assert curve[-1] == regret_of(scores(network, held_out.tokens), held_out).mean()
    assert curve[-1] < 0.3 * regret_of(held_out.greedy, held_out).mean()


def test_from_worlds_to_weights_that_drive(tmp_path):
    found = reproduce(True, "slam-gym reproduce driver", lambda text: None)
    metrics = found.card.metrics
    assert found.card.scenarios == ("office-small", "hall") and metrics["states"]["estimate"] > 20
    learned = metrics["regret held out [.01 E]"]
    assert 0.0 <= learned["low"] <= learned["estimate"] <= learned["high"]
    write(tmp_path / "driver.npz", found)
    loaded = load_driver(tmp_path / "driver.npz")
    assert all(np.array_equal(loaded.arrays[name], found.arrays[name]) for name in SHAPES)
    arguments = ExploreArguments("office-small", (("budget", 60),), split="train")
    assert run_episode(arguments.make("goal"), LearnedDriver(tmp_path / "driver.npz"), 0)["ticks"] == 60
