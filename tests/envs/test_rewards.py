"""What a driver is paid for: rewards telescope, an empty map has error 1, a perfect one 0, provisional is nothing."""

import numpy as np
import pytest

from slam_gym.envs.explore import REWARDS
from slam_gym.geometry import observe
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.active_slam import VirtualMap
from slam_gym.slam.places.fusion import MappedArea
from slam_gym.types import Scan
from tests.rollouts import SCENARIOS, episode, explore, short


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
    for tick, (_, reward, *_) in enumerate(episode(env, seed=1)):
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


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_an_empty_map_has_error_one_and_a_perfect_one_none(scenario) -> None:
    env = explore(scenario)
    env.reset(seed=1)
    targets = env.episode.targets
    assert mapped(env, targets[:0], 2) == 1.0
    assert mapped(env, targets, 2) == pytest.approx(0.0, abs=1e-6)
    half = len(targets) // 2
    assert mapped(env, targets[:half], 2) == pytest.approx(1.0 - half / len(targets), abs=1e-6)


def test_what_was_seen_once_counts_neither_way() -> None:
    env = explore("office")
    env.reset(seed=1)
    targets = env.episode.targets
    assert mapped(env, targets, 1) == 1.0  # right, but provisional
    assert mapped(env, targets + 100.0, 1) == 1.0  # wrong, but provisional
    assert mapped(env, targets[:20] + 100.0, 2) == pytest.approx(1.0 + 20 / len(targets))  # wrong, and confirmed


def test_a_confirmed_feature_is_worth_the_more_the_nearer_it_lies_to_a_true_one() -> None:
    """In units of 1/N: +1 where it is right, 0 at σ₀ from it, −1 from 2σ₀ on."""
    env, rng = explore("hall"), np.random.default_rng(0)
    env.reset(seed=1)
    targets, sigma0 = env.episode.targets, env.scenario.prior_sigma
    for point in targets[rng.integers(len(targets), size=20)] + rng.normal(0.0, 1.5 * sigma0, (20, 2)):
        off = min(np.hypot(*(targets - point).T).min(), 2.0 * sigma0)
        assert mapped(env, point[None], 2) == pytest.approx(1.0 - (1.0 - off / sigma0) / len(targets), abs=1e-9)


@pytest.mark.parametrize("reward", ["a_opt", "d_opt", "entropy"])
def test_uncertainty_of_an_unseen_world_is_the_unit(reward) -> None:
    env = explore(reward=reward)
    env.reset(seed=0)
    ep, error = env.episode, REWARDS[reward]
    started = error(ep)
    ep.virtual_map = VirtualMap(np.array([-5.0, -5.0, 5.0, 5.0]), 1.0, env.scenario.prior_sigma)
    assert error(ep) == pytest.approx(0.0 if reward == "entropy" else 1.0, abs=1e-12)
    assert started < error(ep)  # the first look already showed something
