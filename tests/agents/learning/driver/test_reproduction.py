"""From worlds to weights, in small: the same twice, held out and trained on kept apart, and fit to drive."""

import numpy as np
import pytest

from agents.drivers.goal_network import shapes
from agents.drivers.goal_tokens import TOKEN_FIELDS
from agents.drivers.learned import SIZE, VERSION, LearnedDriver
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.learning.driver.reproduction import reproduce
from slam_gym.weights import load, write


@pytest.fixture(scope="module")
def weights():
    return reproduce(True, "python -m agents.reproduce driver", lambda text: None)


def test_what_it_trains_loads_and_drives(weights, tmp_path):
    write(tmp_path / "driver.npz", weights)
    loaded = load(tmp_path / "driver.npz", VERSION, TOKEN_FIELDS, shapes(SIZE))
    assert all(np.array_equal(loaded.arrays[name], weights.arrays[name]) for name in shapes(SIZE))
    arguments = ExploreArguments("office-small", (("budget", 60),), split="train")
    assert run_episode(arguments.make("goal"), LearnedDriver(tmp_path / "driver.npz"), 0)["ticks"] == 60


def test_the_card_tells_what_was_lost_and_on_what(weights):
    metrics = weights.card.metrics
    assert weights.card.scenarios == ("office-small", "hall") and metrics["states"]["estimate"] > 20
    learned = metrics["regret held out [.01 E]"]
    assert 0.0 <= learned["low"] <= learned["estimate"] <= learned["high"]
