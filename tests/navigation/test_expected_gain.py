"""The gain that a place promises, against an EKF update of a copy of the map."""

import math

import numpy as np
import pytest

from slam_gym.geometry import observe, relative
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.navigation.active_slam import MAX_FEATURES, expected_reduction, features_in_sight
from slam_gym.navigation.explored_grid import WALL, ExploredGrid
from slam_gym.types import Beams, Odometry, Scan
from tests.mapping.small_maps import mapped

DRIFT = np.array([0.03, 0.03, 0.02])
SIGMA = 0.05


def blank_grid() -> ExploredGrid:
    return ExploredGrid(np.array([-15.0, -15.0, 15.0, 15.0]))


def by_ekf(slam_map: StochasticMap, place: np.ndarray, heading: float, measured: np.ndarray) -> float:
    """Drop of Σ tr P_jj in a copy of the map that is driven to the place and sees the features `measured` there."""
    after = slam_map.copy()
    destination = np.array([*place, heading])
    c, s = math.cos(after.pose[2]), math.sin(after.pose[2])
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    noise = turn.T @ np.diag(DRIFT**2) @ turn
    after.predict(Odometry(relative(after.pose, destination), 0.5 * (noise + noise.T)))
    after.update(Scan.from_points(observe(destination, after.positions[measured]), sigma=SIGMA), measured)
    return float(np.trace(slam_map.covariance[3:, 3:]) - np.trace(after.covariance[3:, 3:]))


@pytest.mark.parametrize("seed", range(6))
def test_expected_reduction_is_that_of_an_ekf_update_of_a_copy(seed) -> None:
    rng, (slam_map, *_) = np.random.default_rng(seed), mapped(MapSpec(), seed=seed)
    mean, covariance = slam_map.mean, slam_map.covariance
    places, reach = rng.uniform(-6, 6, (8, 2)), 5.0
    found = expected_reduction(mean, covariance, blank_grid(), places, reach=reach, sigma=SIGMA, drift=DRIFT)
    for place, gain in zip(places, found):
        distances = np.hypot(*(slam_map.positions - place).T)
        measured = np.argsort(distances)[:MAX_FEATURES]
        measured = measured[distances[measured] <= reach]
        expected = by_ekf(slam_map, place, rng.uniform(-math.pi, math.pi), measured)
        assert gain == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert found.max() > 0.0
    np.testing.assert_array_equal(mean, slam_map.mean)
    np.testing.assert_array_equal(covariance, slam_map.covariance)


def test_expected_reduction_counts_what_is_in_reach_and_in_sight_only() -> None:
    slam_map = StochasticMap(pose_covariance=np.diag([0.1, 0.1, 0.01]))
    slam_map.add(Scan.from_points(np.array([[4.0, 0.0]]), sigma=0.3), np.array([0]))
    grid = blank_grid()

    def gain(x: float, reach: float = 6.0) -> float:
        place = np.array([[x, 0.0]])
        found = expected_reduction(
            slam_map.mean, slam_map.covariance, grid, place, reach=reach, sigma=SIGMA, drift=DRIFT
        )
        return float(found[0])

    assert gain(-3.0) == 0.0 and gain(-3.0, reach=8.0) > 0.0  # farther than the sensor sees
    assert gain(0.0) == pytest.approx(by_ekf(slam_map, np.zeros(2), 0.0, np.array([0])), rel=1e-9)
    bearings = np.linspace(-0.6, 0.6, 40)
    grid.integrate(np.zeros(3), Beams(bearings, 2.1 / np.cos(bearings), 6.0))
    assert grid.cells[int(15 / 0.2), int(17.1 / 0.2)] == WALL
    assert gain(0.0) == 0.0 and gain(3.0) > 0.0  # a wall in between, and from beyond it
    slam_map.add(Scan.from_points(np.array([[2.15, 0.0]]), sigma=0.3), np.array([0]))
    assert gain(0.0) > 0.0  # a feature of the wall itself hides behind nothing


def test_features_in_sight_are_near_and_behind_no_wall() -> None:
    grid, m = blank_grid(), StochasticMap()
    m.add(Scan.from_points(np.array([[3.0, 0.0], [0.0, 3.0], [-3.0, 0.0], [9.0, 0.0]]), sigma=0.1), np.arange(4))
    rows, columns = np.indices(grid.cells.shape)
    x, y = grid.origin[0] + (columns + 0.5) * 0.2, grid.origin[1] + (rows + 0.5) * 0.2
    grid._layers[0][(np.abs(x - 1.5) < 0.2) & (np.abs(y) < 1.0)] = WALL
    places = np.array([[0.0, 0.0], [2.5, 0.0], [0.0, -9.0]])
    assert features_in_sight(m.mean, grid, places, 5.0).tolist() == [2, 1, 0]
