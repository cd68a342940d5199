"""Maps of points and scans in them are what they say."""

import numpy as np
import pytest

from slam_gym.bench.feature_index.problems import DENSITY, SIGMA, QueryKind, point_map, query
from slam_gym.geometry import observe


def test_maps_are_as_dense_and_as_good_as_they_say():
    truth, landmarks = point_map(2000, np.random.default_rng(0))
    assert len(truth) / truth.max() ** 2 == pytest.approx(DENSITY, rel=0.02)
    assert (landmarks.positions - truth).std() == pytest.approx(SIGMA, rel=0.05)
    np.testing.assert_allclose(landmarks.covariances[0], SIGMA**2 * np.eye(2))


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("spurious", [0.0, 0.3, 0.5])
def test_scans_are_of_the_nearest_features_or_half_of_twice_as_many(half, spurious):
    rng = np.random.default_rng(1)
    truth = point_map(500, rng).truth
    for _ in range(20):
        scan, pose = query(truth, QueryKind(10, spurious, half), rng)
        local = observe(pose, truth)
        seen = 10 - round(10 * spurious)
        near = local[np.argsort(np.hypot(*local.T))][: 2 * seen if half else seen]
        away = np.hypot(*(scan.points[:, None] - near[None]).transpose(2, 0, 1)).min(axis=1)
        assert len(scan) == 10 and (away < 6 * SIGMA).sum() >= seen


def test_outside_there_is_no_pose_and_nothing_to_pair():
    rng = np.random.default_rng(2)
    truth = point_map(300, rng).truth
    kind = QueryKind(10, 0.3, False, inside=False)
    assert np.isnan(query(truth, kind, rng).pose).all()
    assert kind.row == {"m": 10, "spurious": 0.3, "seen": "all", "inside": False}
