"""The benchmark of many worlds: every vector takes its turns, and resets are spread over the steps."""

import numpy as np

from slam_gym.bench.runner import main
from slam_gym.bench.speed.vector import BUDGET, made, staggered


def test_worlds_that_begin_one_after_the_other_end_so() -> None:
    envs = made("office-small", "twist", 4, 0, overrides={"budget": BUDGET})
    staggered(envs, np.random.default_rng(0), 0)
    left = [1.0 - snapshot for snapshot in envs._observations()["budget"][:, 0]]
    assert len({round(spent, 4) for spent in left}) == 4


def test_the_command_shows_the_ratio_and_the_cost_of_a_reset(monkeypatch, capsys) -> None:
    monkeypatch.setattr("slam_gym.bench.speed.vector.BUDGET", 4)
    main(["vector", "--scenario", "office-small", "--worlds", "2", "--workers", "1", "--blocks", "1"])
    shown = capsys.readouterr().out
    assert "2 worlds, 1 workers" in shown and "of one world" in shown and "a reset alone" in shown
