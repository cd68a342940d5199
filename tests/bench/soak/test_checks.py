"""What the soak looks for is found where it is."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.bench.soak.cases import case
from slam_gym.bench.soak.checks import Broken, Checked, check_copies, check_map, psd, same
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import Scan


def test_covariances_that_are_none_are_told_from_those_that_are():
    root = np.random.default_rng(0).standard_normal((9, 5))
    good = root @ root.T  # of rank five
    scaled = np.diag(10.0 ** np.arange(-4, 5)) @ good @ np.diag(10.0 ** np.arange(-4, 5))
    assert psd(good) and psd(scaled) and psd(np.zeros((3, 3)))
    assert not psd(good - 1e-3 * np.eye(9)) and not psd(np.diag([1.0, -1e-12])) and not psd(np.full((2, 2), np.nan))
    assert not psd(np.array([[1.0, 0.5], [0.0, 1.0]]))


def test_a_map_that_is_not_finite_is_found():
    slam_map = StochasticMap()
    slam_map.add(Scan.from_points([[1.0, 2.0]], sigma=0.1), np.array([0]))
    check_map(slam_map)
    slam_map.place([0.0, 0.0, 0.0], np.diag([1e-6, 1e-6, 1e-6]))
    check_map(slam_map)
    slam_map._x[3] = np.inf
    with pytest.raises(Broken, match="not finite"):
        check_map(slam_map)


def an_explore_case():
    """A short episode of Explore that is paid by the map's error."""
    found = case(0, 0, 30)
    return replace(found, scenario="office-small", extreme="as it is", options={"action": "twist"})


def test_rewards_that_do_not_telescope_are_found():
    checked = Checked(an_explore_case())
    played = checked.play()
    next(played)
    checked.total += 0.01
    with pytest.raises(Broken, match="rewards sum to"):
        list(played)


def test_copies_that_go_on_in_another_way_are_found():
    checked = Checked(an_explore_case())
    played = checked.play()
    for _ in range(4):
        next(played)
    check_copies(checked, {}, 2)
    checked.env.episode.rng.random()  # as if the original had drawn something that its copies do not know of
    checked.env.np_random.bit_generator.state = np.random.default_rng(99).bit_generator.state
    checked.env._snapshot.actions.pop()
    with pytest.raises(Broken, match="goes on in another way"):
        check_copies(checked, {}, 2)


def test_equal_is_to_the_bit():
    assert same({"a": (1.0, np.nan)}, {"a": (1.0, np.nan)}) and not same([0.0], [-0.0])
    assert not same({"a": 1}, {"b": 1}) and not same(np.float32(1), np.float64(1)) and not same([1], (1,))
