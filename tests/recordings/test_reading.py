"""What the readers of logs share."""

import numpy as np
import pytest

from slam_gym.recordings.reading import from_polar, starts_of


@pytest.mark.parametrize("each", [False, True])
def test_points_from_polar_measurements_have_their_first_order_covariance(each) -> None:
    rng = np.random.default_rng(0)
    ranges, bearings = rng.uniform(0.5, 9.0, 50), rng.uniform(-np.pi, np.pi, 50)
    variances = rng.uniform(0.01, 0.1, 50) if each else 0.04
    seen = from_polar(ranges, bearings, variances, 0.02)
    np.testing.assert_allclose(np.hypot(*seen.points.T), ranges)
    np.testing.assert_allclose(np.arctan2(*seen.points.T[::-1]), bearings)
    for i in range(50):
        c, s = np.cos(bearings[i]), np.sin(bearings[i])
        jacobian = np.array([[c, -ranges[i] * s], [s, ranges[i] * c]])
        noise = np.diag([variances[i] if each else variances, 0.02**2])
        np.testing.assert_allclose(seen.covariances[i], jacobian @ noise @ jacobian.T, atol=1e-15)
    assert from_polar(np.empty(0), np.empty(0), 0.1, 0.1).covariances.shape == (0, 2, 2)


def test_steps_start_where_those_before_them_end() -> None:
    assert starts_of([2, 0, 3]).tolist() == [0, 2, 2, 5] and starts_of([]).tolist() == [0]
    assert starts_of(np.array([True, False, True])).dtype == np.int64
