"""What a sensor has in view."""

import math

import numpy as np
import pytest

from slam_gym.bench.sensing import clutter, features_in_view


@pytest.mark.parametrize("seed", range(10))
def test_features_in_view_are_those_near_and_ahead(seed):
    rng = np.random.default_rng(seed)
    features, pose = rng.uniform(-10.0, 10.0, (200, 2)), rng.uniform([-5, -5, -3], [5, 5, 3])
    reach, field_of_view = rng.uniform(2.0, 12.0), rng.uniform(0.2, math.tau)
    expected = []
    for j, (x, y) in enumerate(features - pose[:2]):
        off = (math.atan2(y, x) - pose[2] + math.pi) % math.tau - math.pi
        if math.hypot(x, y) <= reach and abs(off) <= 0.5 * field_of_view:
            expected.append(j)
    assert features_in_view(features, pose, reach, field_of_view).tolist() == expected
    assert len(features_in_view(np.empty((0, 2)), pose, reach)) == 0


@pytest.mark.parametrize("field_of_view", [math.pi / 2, math.pi, math.tau])
def test_clutter_is_as_dense_everywhere_in_view(field_of_view):
    points = clutter(4000, 3.0, field_of_view, np.random.default_rng(0))
    radius, bearing = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    assert radius.max() <= 3.0 and np.abs(bearing).max() <= 0.5 * field_of_view
    assert np.mean(radius < 1.5) == pytest.approx(0.25, abs=0.03)
    assert np.mean(bearing < 0.25 * field_of_view) == pytest.approx(0.75, abs=0.03)
