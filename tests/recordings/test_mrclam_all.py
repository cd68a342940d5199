"""MR.CLAM: the robots of a set as one log."""

import numpy as np
import pytest

from agents.evaluation.mapped_log import map_log
from slam_gym.geometry import compose, relative
from slam_gym.metrics.map_quality import landmark_rmse
from slam_gym.recordings.mrclam import ROBOTS, mrclam
from slam_gym.recordings.mrclam_all import mrclam_all
from slam_gym.recordings.recording import interpolate
from slam_gym.scenarios.recorded import slam_for
from slam_gym.types import SPURIOUS


@pytest.fixture(scope="module")
def folder(data_dir):
    return data_dir / "mrclam" / "MRCLAM_Dataset6"


def test_the_log_of_all_robots_holds_each_of_theirs(folder) -> None:
    together, logs = mrclam_all(folder), [mrclam(folder, robot) for robot in ROBOTS]
    assert len(together) == sum(map(len, logs)) and len(together.points) == sum(len(log.points) for log in logs)
    at = 0
    for log in logs:
        for k in (0, 1, len(log) // 2, len(log) - 1):
            np.testing.assert_array_equal(together.scan(at + k).points, log.scan(k).points)
            np.testing.assert_array_equal(together.sources_of(at + k), log.sources_of(k))
        np.testing.assert_array_equal(together.motions[at + 1 : at + len(log)], log.motions[1:])
        np.testing.assert_allclose(np.diff(together.times[at : at + len(log)]), np.diff(log.times), atol=1e-9)
        at += len(log)


def test_what_links_two_robots_is_their_relative_pose(folder) -> None:
    """Each log begun at the Vicon's pose, and the linked one begun at the first: all start where the Vicon says."""
    together = mrclam_all(folder, link=(0.1, 0.2, 0.3))
    joints = [0, *np.flatnonzero(np.diff(together.times) >= 10.0 - 1e-6) + 1]
    joints = [k for k in joints if k == 0 or together.motion_covariances[k][0, 0] == 0.1**2]
    assert len(joints) == 5

    def true(k: int) -> np.ndarray:
        return interpolate(together.reference_times, together.reference_poses, together.times[k : k + 1])[0]

    for k in joints[1:]:
        np.testing.assert_array_equal(together.motion_covariances[k], np.diag([0.1, 0.2, 0.3]) ** 2)
        off = relative(compose(true(k - 1), together.motions[k]), true(k))
        assert np.abs(off).max() < 1e-3


def test_one_map_of_all_robots_is_right_to_decimetres(folder) -> None:
    """The true association, every scan: the floor for everything else on this log."""
    log = mrclam_all(folder)
    mapped = map_log(log, "true_association", slam_for(log))
    seen = dict(zip(mapped.sources.tolist(), mapped.map.positions))
    place = dict(zip(log.landmark_ids.tolist(), log.landmarks))
    common = [identity for identity in seen if identity != SPURIOUS]
    assert sorted(common) == sorted(place)
    estimated, surveyed = (np.array([where[i] for i in common]) for where in (seen, place))
    assert landmark_rmse(estimated, surveyed, aligned=True) < 0.5
