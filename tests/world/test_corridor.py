"""The reference corridor is the one that is spelt out."""

import numpy as np
import pytest

from slam_gym.geometry import compose, observe
from slam_gym.world import corridor


def test_it_has_22_features_on_each_side_and_looks_the_same_from_all_corners():
    found = corridor.features()
    assert found.shape == (88, 2) and len(np.unique(np.round(found, 9), axis=0)) == 88
    middle = np.array([corridor.SIDE / 2, corridor.SIDE / 2])
    turned = (found - middle) @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + middle
    assert np.hypot(*(found[:, None] - turned).transpose(2, 0, 1)).min(axis=1).max() < 1e-9


@pytest.mark.parametrize("q", [1.0, 2.0])
def test_one_loop_and_four_steps_of_the_next_each_look_complete(q):
    looks = list(corridor.walk_round(np.random.default_rng(0), q))
    assert len(looks) == corridor.STEPS + 1
    pose, world = np.zeros(3), corridor.features()
    for step, (odometry, scan, truth) in enumerate(looks):
        turning = step > 0 and step % 10 == 0
        pose = compose(pose, np.array([float(step > 0), 0.0, np.pi / 2 if turning else 0.0]))
        np.testing.assert_allclose(truth.pose, pose, atol=1e-9)
        sigma = np.array(corridor.TURN_SIGMA if turning else corridor.STRAIGHT_SIGMA) * (step > 0)
        np.testing.assert_allclose(odometry.covariance, q * np.diag(sigma**2))
        local = observe(pose, world)
        seen = np.flatnonzero((np.hypot(*local.T) <= corridor.RANGE) & (local[:, 0] >= 0.0))
        assert sorted(truth.sources) == seen.tolist() and (np.diff(np.arctan2(*scan.points.T[::-1])) > -0.01).all()
        off = scan.points - local[truth.sources]
        assert (np.einsum("mi,mij,mj->m", off, np.linalg.inv(scan.covariances), off) < 25.0).all()
    np.testing.assert_allclose(pose[:2], [4.0, 0.0], atol=1e-9)
