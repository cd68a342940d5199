"""What a scan may take where everything is compatible with everything: candidates, joint tests, memory, and time."""

from pathlib import Path

import numpy as np
import pytest

from slam_gym.association import ASSOCIATORS, gcbb, random_sampling
from slam_gym.association.relocation.problem import LOCATION_LIMIT, TEST_LIMIT
from slam_gym.association.tracking.hypotheses import JOINT_TESTS, MOST_CANDIDATES
from slam_gym.slam.slam import Slam
from slam_gym.types import Landmarks, Odometry, Scan

WEIGHING = ("map_hypothesis", "marginal", "learned")  # all hypotheses
ALLOWED = 256  # [MB]
FORGET = Path("/proc/self/clear_refs")  # of Linux: forgets the peak of memory


def lost_among(features, measurements, seed=0):
    """A scan of a robot that knows neither where it is nor where it is heading."""
    rng, slam = np.random.default_rng(seed), Slam()
    slam.step(Odometry.from_motion(np.zeros(3), 0.0), Scan.from_points(rng.uniform(-8, 8, (features, 2)), sigma=0.1))
    points = rng.uniform(-6, 6, (measurements, 2))
    scan = Scan.from_points(points, sigma=0.3, sizes=rng.uniform(0.2, 1.0, measurements), size_sigma=0.05)
    return scan, slam.predict(Odometry.from_motion([0.1, 0.0, 0.0], [9.0, 9.0, 0.7]), scan)


@pytest.mark.parametrize("name", WEIGHING)
def test_the_limits_leave_a_robot_alone_that_knows_its_way(name):
    rng, slam = np.random.default_rng(1), Slam()
    points = rng.uniform(-8, 8, (60, 2))
    for _ in range(3):
        slam.step(Odometry.from_motion(np.zeros(3), 0.001), Scan.from_points(points, sigma=0.02))
    scan = Scan.from_points(points[:20], sigma=0.02)
    answer = ASSOCIATORS[name](scan, slam.predict(Odometry.from_motion(np.zeros(3), 0.01), scan))
    assert answer.effort.joint_tests < JOINT_TESTS / 100
    assert answer.features.tolist() == list(range(20))


def peak() -> float:
    """[MB] of memory that the process has had at most since `FORGET` was written to; 0 where that is not Linux."""
    if not FORGET.exists():
        return 0.0
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


@pytest.mark.parametrize("name", WEIGHING)
def test_work_and_memory_are_bounded_and_the_answer_says_so(name):
    for seed, measurements in ((0, 20), (0, 150), (1, 150)):
        scan, prediction = lost_among(400, measurements, seed)
        if FORGET.exists():
            FORGET.write_text("5", encoding="utf-8")
        before = peak()
        answer = ASSOCIATORS[name](scan, prediction)
        assert seed == 0 or peak() - before <= ALLOWED  # all is compiled by then, and what is kept is there
        assert answer.effort.limit_hit
        # the first look at each of up to eleven headings keeps four hypotheses
        assert answer.effort.joint_tests <= JOINT_TESTS + 11 * 4 * MOST_CANDIDATES
        if answer.new is not None:
            assert not answer.new.any(), "what may have been left out starts no feature"


def test_searches_without_a_prior_end():
    rng = np.random.default_rng(0)
    scan = Scan.from_points(rng.uniform(-4, 4, (20, 2)), sigma=0.3)
    landmarks = Landmarks.from_points(rng.uniform(-6, 6, (120, 2)), sigma=0.2)
    deep, sampled = gcbb(scan, landmarks), random_sampling(scan, landmarks)
    assert deep.effort.limit_hit and not deep.accepted and deep.effort.joint_tests <= LOCATION_LIMIT
    assert sampled.effort.limit_hit and not sampled.accepted
    assert sampled.effort.joint_tests < LOCATION_LIMIT + len(landmarks)  # a level may test all features
    deep = gcbb(scan, Landmarks.from_points(rng.uniform(-4, 4, (35, 2)), sigma=0.5), min_pairings=20)
    assert deep.effort.limit_hit and deep.effort.orientation_tests < TEST_LIMIT / 20, "wide gates: nodes cost most"
