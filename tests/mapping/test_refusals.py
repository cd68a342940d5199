"""What a map refuses: it says why, and nothing in it has changed."""

import numpy as np
import pytest

from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import UNPAIRED, Array, Odometry, Scan
from tests.mapping.small_maps import mapped
from tests.oracles.map import Q, make_scan


def scan_with(points: Array | None = None, covariances: Array | None = None) -> Scan:
    return make_scan(
        np.ones((2, 2)) if points is None else points,
        np.tile(np.eye(2), (2, 1, 1)) if covariances is None else covariances,
    )


BAD_SCANS = {
    "NaN point": scan_with(points=np.array([[1.0, 1.0], [1.0, np.nan]])),
    "infinite point": scan_with(points=np.array([[1.0, 1.0], [np.inf, 1.0]])),
    "NaN covariance": scan_with(covariances=np.array([np.eye(2), [[1.0, np.nan], [np.nan, 1.0]]])),
    "indefinite": scan_with(covariances=np.array([np.eye(2), [[1.0, 2.0], [2.0, 1.0]]])),
    "negative": scan_with(covariances=np.array([np.eye(2), -np.eye(2)])),
    "asymmetric": scan_with(covariances=np.array([np.eye(2), [[1.0, 0.1], [0.2, 1.0]]])),
    "infinite covariance": scan_with(covariances=np.array([np.eye(2), np.diag([np.inf, 1.0])])),
}


@pytest.mark.parametrize("name", BAD_SCANS)
def test_a_bad_measurement_is_refused_by_number_and_changes_nothing(name: str) -> None:
    m, _, _ = mapped()
    before = m.mean, m.covariance, m.seen
    with pytest.raises(ValueError, match="measurement 1"):
        m.update(BAD_SCANS[name], np.array([0, 1]))
    with pytest.raises(ValueError, match="measurement 1"):
        m.add(BAD_SCANS[name], np.array([1]))
    for old, new in zip(before, (m.mean, m.covariance, m.seen)):
        np.testing.assert_array_equal(old, new)
    m.update(BAD_SCANS[name], np.array([0, UNPAIRED]))  # unpaired, it does no harm


@pytest.mark.parametrize("features", [[0, -2], [0, 1000], [0]])
def test_pairings_that_make_no_sense_are_refused(features: list[int]) -> None:
    m, _, _ = mapped()
    mean = m.mean
    with pytest.raises(ValueError, match="features"):
        m.update(scan_with(), np.array(features))
    np.testing.assert_array_equal(m.mean, mean)
    with pytest.raises(ValueError, match="remove"):
        m.remove(np.array([0, m.n]))


@pytest.mark.parametrize(
    "odometry",
    [
        Odometry(np.array([0.0, np.nan, 0.0]), Q),
        Odometry(np.array([np.inf, 0.0, 0.0]), Q),
        Odometry(np.zeros(3), np.full((3, 3), np.nan)),
        Odometry(np.zeros(3), -Q),
        Odometry(np.zeros(3), np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 0.0], [2.0, 0.0, 1.0]])),
    ],
)
def test_bad_odometry_is_refused_and_changes_nothing(odometry: Odometry) -> None:
    m, _, _ = mapped()
    mean, covariance = m.mean, m.covariance
    with pytest.raises(ValueError, match="odometry"):
        m.predict(odometry)
    np.testing.assert_array_equal(m.mean, mean)
    np.testing.assert_array_equal(m.covariance, covariance)


def test_no_uncertainty_anywhere_is_refused() -> None:
    m, exact = StochasticMap(), scan_with(covariances=np.zeros((2, 2, 2)))
    m.add(exact, np.array([0]))
    with pytest.raises(ValueError, match="singular"):
        m.update(exact, np.array([0, UNPAIRED]))


@pytest.mark.parametrize(
    "arguments",
    [
        {"pose": [0.0, 0.0]},
        {"pose": [0.0, np.nan, 0.0]},
        {"pose_covariance": -np.eye(3)},
        {"pose_covariance": np.eye(2)},
        {"capacity": 0},
    ],
)
def test_a_map_that_cannot_start_says_why(arguments: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(arguments))):
        StochasticMap(**arguments)
