"""What an episode says of its estimate is what the metrics say of it."""

import numpy as np
import pytest

from slam_gym.geometry import compose, relative
from slam_gym.metrics import map_quality
from slam_gym.metrics.consistency import pose_nees
from slam_gym.simulation.appraisal import appraise_map, appraise_pose
from slam_gym.simulation.kidnapping import is_right
from tests.rollouts import episode, explore
from tests.simulation.test_kidnapping import pose_is_right


def test_map_error_coverage_and_nees_are_those_of_the_metrics() -> None:
    env = explore("office", action="twist")
    for count, _ in enumerate(episode(env, 60, seed=3)):
        e, m = env.episode, env.episode.slam.map
        if count % 10:
            continue
        expected = map_quality.map_error(e.landmarks, e.targets, e.scenario.prior_sigma)
        assert e.map_error() == pytest.approx(expected, rel=1e-12) and 0.0 < expected <= 1.0
        assert e.coverage() == map_quality.coverage(e.grid.cells, e._places)
        told = appraise_map(m.arrays, m.n, m.spec.confirmations, e.base, e._indexed, e._cells, e._places)
        assert told == (e.map_error(), e.coverage())
        true = relative(e.base, e.poses[-1])
        assert e.nees[-1] == pytest.approx(pose_nees(m.pose, m.pose_covariance, true), rel=1e-9)


@pytest.mark.parametrize("off", [(0.1, 0.1, 0.05), (0.4, 0.4, 0.0), (0.0, 0.0, -0.3)])
def test_a_pose_is_off_by_what_it_is_off_in_the_world(off) -> None:
    base, pose, out = np.array([3.0, -2.0, 2.5]), np.array([1.0, 0.5, -1.2]), np.empty(3)
    true = compose(compose(base, pose), np.array(off))
    state, P = np.concatenate([pose, np.zeros(5)]), np.zeros((8, 8))
    P[:3, :3] = 0.01 * np.eye(3)
    _, distance, turn = appraise_pose(state, P, base, true, out)
    np.testing.assert_array_equal(out, pose)
    assert distance == pytest.approx(np.hypot(*off[:2])) and turn == pytest.approx(abs(off[2]))
    assert is_right(distance, turn) == pose_is_right(compose(base, pose), true)
