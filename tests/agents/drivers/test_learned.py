"""The learned driver that ships: its weights fit what the environment shows, and nothing else is needed to drive."""

import numpy as np

from agents.drivers.base import make_agent
from agents.drivers.learned import (
    CHOICES,
    MEMBERS,
    SHAPES,
    TOKEN_FIELDS,
    LearnedDriver,
    Tokens,
    load_driver,
    scores,
    tokens_of,
)
from agents.evaluation.episodes import ExploreArguments, reset_arguments
from slam_gym.association.prediction import Prediction
from slam_gym.envs.observation import encode_goals, observe
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.simulation.goals import Goals
from slam_gym.types import Beams, Scan
from slam_gym.weights import write
from tests.agents.drivers import offered

COVARIANCE = np.diag([0.01, 0.04, 0.0025])  # of the pose


def scene():
    """What the environment shows of a square room, three metres to each wall, with a frontier ahead and a revisit."""
    bearings = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    ranges = 3.0 / np.maximum(np.abs(np.cos(bearings)), np.abs(np.sin(bearings)))
    grid, slam_map = ExploredGrid(np.array([-15.0, -15.0, 15.0, 15.0])), StochasticMap(pose_covariance=COVARIANCE)
    for _ in range(3):
        grid.integrate(slam_map.pose, Beams(bearings, ranges, 6.0))
    positions, legal = np.zeros((16, 2)), np.zeros(16, bool)
    positions[[0, 1, 11]], legal[[0, 1, 11]] = [[0.0, 0.0], [2.0, 0.0], [-2.0, -2.0]], True
    numbers = np.zeros((4, 16))
    numbers[:, 1], numbers[:, 11] = (2.0, 30.0, 0.01, 4.0), (3.0, 1.0, 0.2, 6.0)
    goals = Goals(positions, numbers[0], numbers[1], numbers[2], legal, numbers[3])
    nothing, expected = Scan.from_points(np.empty((0, 2)), sigma=0.1), np.empty((0, 2))
    observation = observe(nothing, Prediction.from_gaussian(expected, np.empty((0, 0))), slam_map, grid, 5, 0.75)
    observation |= {"goals": encode_goals(goals, slam_map.pose)}
    return observation, {"action_mask": legal, "pose": slam_map.pose, "ticks": 200}


PINNED = {
    "distance": (0.0, 0.2), "cosine of the bearing": (0.0, 1.0), "path": (0.0, 0.2), "area": (0.0, 0.6),
    "fraction of the time left": (0.008, 0.048), "budget": (0.75, 0.75), "log ticks left": (0.779, 0.779),
    "area in all": (0.06, 0.06), "frontiers": (0.1, 0.1),
}  # fmt: skip
"""Fields of the tokens of look around and frontier of that scene, as the weights were trained on them."""


def test_the_environment_shows_what_the_weights_were_trained_on():
    observation, info = scene()
    rows, tokens = tokens_of(observation, 200.0, info["action_mask"])
    fields = tokens.fields[[rows.tolist().index(0), rows.tolist().index(1)]]
    for name, values in PINNED.items():
        assert np.allclose(fields[:, TOKEN_FIELDS.index(name)], values, atol=2e-3), name
    free, wall, unknown = (fields[:, TOKEN_FIELDS.index(f"{name} within 6")] for name in ("free", "wall", "unknown"))
    assert free[0] > 0.7 and 0.1 < wall[0] < 0.3 and unknown[0] < 0.2
    assert free[1] < free[0] and unknown[1] > unknown[0]


def test_it_drives_by_its_weights_and_the_same_way_each_time(tmp_path):
    observation, info = scene()
    agent, chosen = make_agent("learned"), []
    for _ in range(2):
        agent.reset(0)
        chosen.append(agent.act(observation, info))
    assert chosen[0] == chosen[1] and info["action_mask"][chosen[0]]
    shipped = load_driver("driver")
    for sign in (1.0, -1.0):  # whatever they prefer
        turned = {name: sign * shipped.arrays[name] for name in ("greed", "score.weight", "score.bias")}
        write(tmp_path / "own.npz", shipped._replace(arrays=shipped.arrays | turned))
        assert (LearnedDriver(tmp_path / "own.npz").act(observation, info) == chosen[0]) == (sign > 0.0)


def test_it_looks_around_once_at_a_place_and_goes_back_only_where_no_frontier_is_left():
    observation, info = scene()
    agent = make_agent("learned")
    chosen = [agent.act(observation, info) for _ in range(4)]
    assert chosen.count(0) <= 1 and chosen[1:] == [1, 1, 1]
    left = info | {"action_mask": info["action_mask"] & (np.arange(16) != 1)}
    assert agent.act(observation, left) == make_agent("information_gain").act(observation, left) == 11


# -- the network: what its scores may depend on, and what they may not -------------------------------------------------

RNG = np.random.default_rng(0)
ARRAYS = {name: RNG.normal(0.0, 0.2, (MEMBERS, *shape)).astype(np.float32) for name, shape in SHAPES.items()}


def some_tokens(goals=7):
    rng = np.random.default_rng(1)
    fields, places = rng.normal(size=(goals, len(TOKEN_FIELDS))), rng.uniform(-2.0, 2.0, (goals, 2))
    gaps = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    return Tokens(fields, gaps, rng.uniform(-3.0, 0.0, goals), rng.random(goals) < 0.7)


def permuted(tokens, order):
    fields, gaps, greedy, legal = (part[order] for part in tokens)
    return Tokens(fields, gaps[:, order], greedy, legal)


def test_the_order_of_goals_does_not_matter_and_their_number_may_change():
    tokens, order = some_tokens(), np.random.default_rng(2).permutation(7)
    assert np.allclose(scores(ARRAYS, permuted(tokens, order)), scores(ARRAYS, tokens)[:, order])
    more = permuted(tokens, np.append(np.arange(7), 0))
    more.legal[-1] = False
    assert np.allclose(scores(ARRAYS, more)[:, :-1], scores(ARRAYS, tokens))


def test_only_the_most_promising_goals_that_are_legal_are_weighed():
    frontiers = [(0.5 * k, 1.0, 1.0 + k, area, 0.0) for k, area in enumerate((9.0, 40.0, 5.0, 70.0, 20.0, 60.0))]
    shown, info = offered(frontiers)
    shown = scene()[0] | {"goals": shown["goals"]}
    legal = info["action_mask"] & (np.arange(16) > 0)
    assert tokens_of(shown, 100.0, legal)[0].tolist() == [2, 4, 6, 1]  # area per tick
    rows, tokens = tokens_of(shown, 100.0, np.arange(16) == 5)
    assert rows[0] == 5 and tokens.legal.tolist() == [True] + [False] * (CHOICES - 1)


def test_tokens_of_an_episode_are_finite_and_know_the_ticks_that_are_left():
    env, rng = ExploreArguments("office-small", split="train").make("goal"), np.random.default_rng(0)
    used, over = 0, False
    observation, info = env.reset(**reset_arguments(0))
    while not over:
        _, tokens = tokens_of(observation, used, info["action_mask"])
        assert np.isfinite(tokens.fields).all() and np.abs(tokens.fields).max() <= 4.0
        if used:
            left = tokens.fields[0, TOKEN_FIELDS.index("log ticks left")]
            assert np.isclose(10.0 ** (left + 2.0) - 1.0, 300 - used, rtol=1e-3, atol=0.1)
        observation, _, over, _, info = env.step(int(rng.choice(np.flatnonzero(info["action_mask"]))))
        used += info["ticks"]
