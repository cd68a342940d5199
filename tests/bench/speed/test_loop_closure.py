"""The mapped field and the scans taken in it."""

import numpy as np
import pytest

from slam_gym.bench.speed.loop_closure import CARRIED, RANGE, SIGMA, TRACKED, closure_scan, mapped_field
from slam_gym.geometry import observe
from slam_gym.types import UNPAIRED


@pytest.fixture(scope="module")
def field():
    return mapped_field(150, np.random.default_rng(0))


def test_the_map_is_of_the_field(field):
    assert len(field.features) / field.features.max() ** 2 == pytest.approx(0.6, rel=0.05)
    assert len(set(field.identities.tolist())) == field.map.n > 140
    away = np.hypot(*(field.map.positions - observe(np.array([0.0, 0, 0]), field.features[field.identities])).T)
    assert np.median(away) < 0.2
    index = field.index
    np.testing.assert_array_equal(index[field.identities], np.arange(field.map.n))
    assert (index == UNPAIRED).sum() == 150 - field.map.n


@pytest.mark.parametrize("seed", range(5))
def test_a_scan_shows_features_of_the_map_and_clutter(field, seed):
    rng, n = np.random.default_rng(seed), field.map.n
    one = closure_scan(field, 20, CARRIED, rng, spurious=0.3)
    assert len(one) == 20 and (one.truth == UNPAIRED).sum() >= 6 and field.map.n == n
    assert np.hypot(*one.scan.points.T).max() <= RANGE + 6 * SIGMA
    real = one.truth[one.truth != UNPAIRED]
    assert len(set(real.tolist())) == len(real) <= 14 and len(one.prediction) == n
    bearings = np.arctan2(one.scan.points[:, 1], one.scan.points[:, 0])
    assert (np.diff(bearings) < -0.5).sum() <= 1  # in their order, but for noise and the cut of the angle


def test_predictions_are_off_as_the_odometry_says(field):
    rng, wide, narrow = np.random.default_rng(1), [], []
    for sigma, away in ((CARRIED, wide), (TRACKED, narrow)):
        for _ in range(20):
            one = closure_scan(field, 12, sigma, rng, spurious=0.0)
            known = one.truth != UNPAIRED
            off = one.scan.points[known] - one.prediction.positions[one.truth[known]]
            S = one.scan.covariances[known] + one.prediction.covariances[one.truth[known]]
            away.extend(e @ np.linalg.solve(s, e) for e, s in zip(off, S))
    assert np.mean(wide) == pytest.approx(2.0, abs=0.8) and np.mean(narrow) == pytest.approx(2.0, abs=0.8)
