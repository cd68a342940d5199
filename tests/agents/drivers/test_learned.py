"""The learned driver that ships: its weights fit what the environment shows, and nothing else is needed to drive."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agents.drivers.base import make_agent
from agents.drivers.goal_network import shapes
from agents.drivers.goal_tokens import TOKEN_FIELDS, tokens_of
from agents.drivers.learned import SIZE, VERSION, LearnedDriver
from slam_gym.envs.goal_observation import encode_goals
from slam_gym.envs.observation import observe
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.simulation.goals import Goals
from slam_gym.types import Beams, Prediction, Scan
from slam_gym.weights import Weights, card_of, load
from tests.agents.drivers import offered

ROOT = Path(__file__).parents[3]


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
    fields = tokens_of(scene()[0], 200.0).fields[[0, 1]]
    for name, values in PINNED.items():
        assert np.allclose(fields[:, TOKEN_FIELDS.index(name)], values, atol=2e-3), name
    free, wall, unknown = (fields[:, TOKEN_FIELDS.index(f"{name} within 6")] for name in ("free", "wall", "unknown"))
    assert free[0] > 0.7 and 0.1 < wall[0] < 0.3 and unknown[0] < 0.2
    assert free[1] < free[0] and unknown[1] > unknown[0]


def test_weights_that_ship_fit_the_tokens_of_now_and_no_others():
    assert card_of("driver").inputs == TOKEN_FIELDS
    load("driver", VERSION, TOKEN_FIELDS, shapes(SIZE))
    with pytest.raises(ValueError, match="other inputs"):
        load("driver", VERSION, (*TOKEN_FIELDS, "one more"), shapes(SIZE))


def test_it_drives_by_its_weights_and_the_same_way_each_time():
    observation, info = scene()
    agent, chosen = make_agent("learned"), []
    for _ in range(2):
        agent.reset(0)
        chosen.append(agent.act(observation, info))
    assert chosen[0] == chosen[1] and info["action_mask"][chosen[0]]
    shipped = load("driver", VERSION, TOKEN_FIELDS, shapes(SIZE))
    for sign in (1.0, -1.0):  # whatever they prefer
        turned = {name: sign * shipped.arrays[name] for name in ("greed", "score.weight", "score.bias")}
        other = LearnedDriver(Weights(shipped.card, shipped.arrays | turned))
        assert (other.act(observation, info) == chosen[0]) == (sign > 0.0)


def test_it_looks_around_once_at_a_place_and_goes_back_only_where_no_frontier_is_left():
    observation, info = scene()
    agent = make_agent("learned")
    chosen = [agent.act(observation, info) for _ in range(4)]
    assert chosen.count(0) <= 1 and chosen[1:] == [1, 1, 1]
    left = info | {"action_mask": info["action_mask"] & (np.arange(16) != 1)}
    assert agent.act(observation, left) == make_agent("information_gain").act(observation, left) == 11


def test_only_looking_around_on_offer():
    observation, info = offered()
    shown = scene()[0] | {"goals": observation["goals"]}
    assert make_agent("learned").act(shown, info) == 0


def test_it_needs_no_torch():
    code = "import sys; from agents.drivers.base import make_agent; make_agent('learned'); "
    code += "sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
