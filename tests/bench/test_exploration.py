"""Explorations that benchmarks look into."""

from dataclasses import replace

import numpy as np

from slam_gym.bench.exploration import explore, explorer
from slam_gym.scenarios import get_scenario


def test_an_exploration_leaves_its_start_and_is_the_same_for_the_same_seed():
    env = explorer(replace(get_scenario("office"), budget=120), split="test", associator="jcbb")
    drives = []
    for _ in range(2):
        steps = list(explore(env, 3, world=1))
        assert len(steps) == 120 and all(step.microseconds > 0.0 for step in steps)
        assert "map_quality" in steps[-1].info
        drives.append(np.array(env.episode.poses))
    np.testing.assert_array_equal(drives[0], drives[1])
    assert np.hypot(*(drives[0][:, :2] - drives[0][0, :2]).T).max() > 2.0
