"""What an agent sees: squashed values come back, unknown is zero, the nearest come first."""

import math

import numpy as np
import pytest

from slam_gym.association.prediction import Prediction
from slam_gym.association.walks import squash
from slam_gym.envs.observation import GOAL_FIELDS, POINT_FIELDS, encode_goals, observe, unsquash, unsquash_goals
from slam_gym.geometry import transform
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.simulation.goals import FRONTIERS, SLOTS, Goals
from slam_gym.types import Scan

NOTHING = Scan.from_points(np.empty((0, 2)), sigma=0.1)
NOTHING_EXPECTED = Prediction.from_gaussian(np.empty((0, 2)), np.empty((0, 0)))


def observed(scan, measurements, prediction=NOTHING_EXPECTED, pose_covariance=None) -> dict:
    slam_map, grid = StochasticMap(pose_covariance=pose_covariance), ExploredGrid(np.array([-5.0, -5.0, 5.0, 5.0]))
    return observe(scan, prediction, slam_map, grid, measurements, 1.0)


def rows(vector: np.ndarray) -> np.ndarray:
    return vector.reshape(-1, len(POINT_FIELDS)).astype(float)


@pytest.mark.parametrize("scale", [0.05, 1.0, 6.0])
def test_squashed_values_come_back_and_stay_below_one(scale) -> None:
    values = np.array([-1e4, -3.0, -0.01, 0.0, 0.01, 3.0, 1e4])
    squashed = squash(values, scale)
    assert (np.abs(squashed) < 1.0).all() and (np.diff(squashed) > 0.0).all()
    np.testing.assert_allclose(unsquash(squashed, scale), values, rtol=2e-3)
    assert np.isfinite(unsquash(np.array([-1.0, 1.0], np.float32), scale)).all()


def test_a_scan_is_shown_nearest_first_and_unknown_sizes_are_zero() -> None:
    points = np.array([[4.0, 3.0], [1.0, 0.0], [0.0, -2.0]])
    covariances = np.array([np.diag([0.04, 0.01]), [[0.01, 0.005], [0.005, 0.01]], np.zeros((2, 2))])
    scan = Scan.from_points(points, covariances=covariances, sizes=[1.0, np.nan, 3.0], size_sigma=[0.1, np.nan, 0.1])
    shown = rows(observed(scan, 5)["scan"])
    np.testing.assert_array_equal(shown[:, 0], [1, 1, 1, 0, 0])
    assert not shown[3:].any()
    np.testing.assert_allclose(unsquash(shown[:3, 1:3], 6.0), points[[1, 2, 0]], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(unsquash(shown[:3, 3], 0.1), [0.1, 1e-6, 0.2], rtol=1e-5)
    np.testing.assert_allclose(shown[:3, 4], [0.5, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(unsquash(shown[:3, 6], 1.0), [0.0, 3.0, 1.0], rtol=1e-5)
    assert len(rows(observed(scan, 2)["scan"])) == 2


def test_uncertainty_is_in_standard_deviations() -> None:
    shown = observed(NOTHING, 5, pose_covariance=np.diag([0.04, 0.0, 0.0025]))["uncertainty"].astype(float)
    np.testing.assert_allclose(shown, [0.2 / 0.3, 0.0, 0.05 / 0.1], rtol=1e-6)


def some_goals(rng: np.random.Generator) -> Goals:
    legal = rng.random(SLOTS) < 0.6
    legal[0] = True
    masked = legal.astype(float)
    return Goals(
        positions=rng.uniform(-20.0, 20.0, (SLOTS, 2)) * masked[:, None],
        lengths=rng.uniform(0.0, 30.0, SLOTS) * masked,
        areas=rng.uniform(0.0, 20.0, SLOTS) * masked,
        reductions=rng.uniform(0.0, 0.3, SLOTS) * masked,
        legal=legal,
        in_view=rng.uniform(0.0, 15.0, SLOTS) * masked,
    )


@pytest.mark.parametrize("seed", range(3))
def test_goals_come_back_in_their_units_and_in_the_frame_of_the_robot(seed) -> None:
    rng = np.random.default_rng(seed)
    goals, pose = some_goals(rng), np.array([1.0, -2.0, rng.uniform(-math.pi, math.pi)])
    shown = encode_goals(goals, pose)
    assert shown.shape == (SLOTS * len(GOAL_FIELDS),) and shown.dtype == np.float32
    assert (np.abs(shown) <= 1.0).all()
    told = unsquash_goals(shown)
    assert tuple(told) == GOAL_FIELDS
    legal = goals.legal
    np.testing.assert_array_equal(told["legal"] == 1.0, legal)
    positions = transform(pose, np.stack([told["x"], told["y"]], axis=1))
    np.testing.assert_allclose(positions[legal], goals.positions[legal], rtol=1e-4, atol=1e-4)
    numbers = {"path": goals.lengths, "area": goals.areas, "reduction": goals.reductions, "in_view": goals.in_view}
    for name, values in numbers.items():
        np.testing.assert_allclose(told[name], values, rtol=1e-4, atol=1e-6)
    assert all(not told[name][~legal].any() for name in GOAL_FIELDS)
    assert (told["frontier"][1 : 1 + FRONTIERS] == legal[1 : 1 + FRONTIERS]).all() and not told["frontier"][0]
    assert (told["revisit"][1 + FRONTIERS :] == legal[1 + FRONTIERS :]).all()


def test_a_vector_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="13 numbers do not divide into rows of 9"):
        unsquash_goals(np.zeros(13, np.float32))
