"""The training finds what a made-up teacher values, and stops at being no worse than greedy where there is nothing."""

import numpy as np

from agents.drivers.goal_network import Size
from agents.drivers.goal_tokens import TOKEN_FIELDS
from agents.learning.driver.examples import Examples
from agents.learning.driver.training import Training, fit, regrets

SIZE = Size(width=8, heads=2, layers=1)
SHORT = Training(epochs=12, batch=32, rate=1e-2)


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


def test_it_learns_to_choose_what_the_teacher_values():
    curve = []
    network = fit(states(400, 0), SIZE, SHORT, lambda n: curve.append(regrets([n], states(200, 1)).learned.mean()))
    found = regrets([network], states(200, 1))
    assert found.learned.mean() == curve[-1] < 0.3 * found.greedy.mean() and len(curve) == SHORT.epochs
    assert curve[-1] < 0.5 * curve[0]


def test_the_same_seed_gives_the_same_network_and_another_seed_another():
    train, short = states(64, 0), Training(epochs=2, seed=3)
    one, two, other = fit(train, SIZE, short), fit(train, SIZE, short), fit(train, SIZE, Training(epochs=2, seed=4))
    arrays = [network.arrays() for network in (one, two, other)]
    assert all(np.array_equal(arrays[0][name], arrays[1][name]) for name in arrays[0])
    assert not np.array_equal(arrays[0]["embed.weight"], arrays[2]["embed.weight"])


def test_regret_is_what_the_choice_is_worse_than_the_best():
    legal = np.array([[True, True, False]])
    example = Examples(
        np.zeros((1, 3, len(TOKEN_FIELDS))),
        np.zeros((1, 3, 3)),
        np.array([[2.0, 1.0, 9.0]]),
        legal,
        np.array([[1.0, 4.0, 0.0]]),
    )
    assert regrets([fit(states(32, 0), SIZE, Training(epochs=1))], example).greedy == 3.0
