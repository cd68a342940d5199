"""A robot that is lost: what is not learned, when the search is asked, and how the step goes on from its answer."""

import numpy as np

from slam_gym.slam.relocation import RelocatingSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import UNPAIRED, Effort, Odometry, Relocation, Scan

STILL = Odometry.from_motion([0, 0, 0], [0.01, 0.01, 0.003])


def scan_of(points) -> Scan:
    return Scan.from_points(points, sigma=0.02)


def found(features: list[int], pose: np.ndarray) -> Relocation:
    return Relocation(np.array(features), pose, 1e-4 * np.eye(3), 0.0, 1, 2, False, 0, Effort())


def test_the_search_is_asked_once_too_many_scans_were_doubted_and_only_then() -> None:
    calls = []

    def relocate(slam: Slam, scan: Scan) -> Relocation:
        calls.append(slam.map.step)
        return found([1, 0], slam.map.pose)

    slam = RelocatingSlam(SlamSpec(lost_scans=3, min_expected=2), relocate)
    here = scan_of([[1, 0], [2, 1]])
    for _ in range(5):
        slam.step(STILL, here)
    assert not calls and not slam.lost
    paired = []
    for turn in range(3):
        # a different place each time, so that what the last scan started is no help
        step = slam.step(STILL, scan_of(np.array([[4, 4], [5, 3]]) + 3.0 * turn))
        paired.append(step.hypothesis.features.tolist())
    assert calls == [7] and slam.relocations == 1 and not slam.lost
    assert paired == [[UNPAIRED, UNPAIRED], [UNPAIRED, UNPAIRED], [1, 0]]


def test_a_doubted_scan_leaves_the_map_as_the_odometry_does() -> None:
    slam, plain = RelocatingSlam(SlamSpec(min_expected=2), lambda slam, scan: None), Slam(SlamSpec(min_expected=2))
    for each in (slam, plain):
        for _ in range(3):
            each.step(STILL, scan_of([[1, 0], [2, 1]]))
    slam.step(STILL, scan_of([[4, 4], [5, 3]]))
    plain.map.predict(STILL)
    assert slam.doubted and slam.map.n == 2
    np.testing.assert_array_equal(slam.map.mean, plain.map.mean)
    np.testing.assert_array_equal(slam.map.covariance, plain.map.covariance)


def test_after_relocation_new_features_are_those_that_fit_nothing_at_the_new_pose() -> None:
    here, moved = scan_of([[1, 0], [2, 1]]), Odometry(np.array([0.0, 8.0, 0.0]), 1e-4 * np.eye(3))
    spec = SlamSpec(lost_scans=1, min_expected=2, reach=20.0)
    slam = RelocatingSlam(spec, lambda slam, scan: found([0, UNPAIRED], np.zeros(3)))
    slam.step(STILL, here)
    slam.step(STILL, here)
    step = slam.step(moved, here)
    assert not step.created.any() and slam.map.n == 2  # the second measurement fits feature 1, once relocated


def test_the_pose_found_is_what_the_pairings_tell() -> None:
    here, there = [[1, 0], [2, 1], [3, -1]], np.array([2.0, 1.0, 0.0])
    slam = RelocatingSlam(SlamSpec(lost_scans=1, min_expected=2), lambda slam, scan: found([0, 1, 2], there))
    for _ in range(4):
        slam.step(STILL, scan_of(here))
    slam.step(Odometry.from_motion([0, 0, 3.0], 0.01), scan_of(np.array(here) - there[:2]))
    np.testing.assert_allclose(slam.map.pose, there, atol=0.02)
