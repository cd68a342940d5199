"""What a driver is paid for: rewards telescope, a perfect map has error 0, what is provisional is nothing."""

import numpy as np
import pytest

from slam_gym.envs.explore import REWARDS
from slam_gym.geometry import observe
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.places.fusion import MappedArea
from slam_gym.types import Scan
from tests.rollouts import episode, explore, short


@pytest.mark.parametrize("action", ["goal", "twist"])
@pytest.mark.parametrize("reward", list(REWARDS))
def test_rewards_sum_to_the_first_error_minus_the_last(reward, action) -> None:
    env, error = explore(short(150), action=action, reward=reward), REWARDS[reward]
    total, errors = 0.0, []
    for _, paid, *_ in episode(env, seed=5):
        total += paid
        errors.append(error(env.episode))
        assert total == pytest.approx(errors[0] - errors[-1], abs=1e-12)
    assert errors[-1] < errors[0] - 0.01, "nothing was learnt, so nothing was tested"


def test_in_a_second_map_whose_place_nobody_knows_certainty_pays_nothing() -> None:
    env, paid = explore(short(60), action="twist", reward="a_opt"), []
    for tick, (_, reward, *_, info) in enumerate(episode(env, seed=1)):
        assert np.isnan(info["pose_nees"]) == (tick > 30)
        if tick == 30:
            env.episode.slam.atlas.inactive.append(MappedArea(StochasticMap(), CovisibilityGraph()))
        paid.append(reward)
    assert any(paid[1:30]) and not any(paid[31:]) and len(paid) > 50


def mapped(env, points: np.ndarray, times: int) -> float:
    """E once the map holds `points` (k, 2) in W, each seen so many times, and nothing else."""
    ep = env.episode
    ep.slam.map = StochasticMap()
    scan = Scan.from_points(observe(ep.base, np.ascontiguousarray(points)), sigma=1e-3)
    features = ep.slam.map.add(scan, np.arange(len(scan)))
    for _ in range(times - 1):
        ep.slam.map.end_of_step()
        ep.slam.map.update(scan, features)
    ep.ticks += 1  # the error is worked out once a tick
    return ep.map_error()


def test_what_was_seen_once_counts_neither_way() -> None:
    env = explore("office")
    env.reset(seed=1)
    targets = env.episode.targets
    assert mapped(env, targets, 2) == pytest.approx(0.0, abs=1e-6)  # a perfect map
    assert mapped(env, targets, 1) == 1.0  # right, but provisional
    assert mapped(env, targets + 100.0, 1) == 1.0  # wrong, but provisional
    assert mapped(env, targets[:20] + 100.0, 2) == pytest.approx(1.0 + 20 / len(targets))  # wrong, and confirmed
