"""Features that should be in view and are never measured: which of them are removed, and when."""

import numpy as np
import pytest

from slam_gym.association.prediction import SlamStep
from slam_gym.navigation.explored_grid import FREE, WALL, ExploredCells
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Odometry, Scan

STILL = Odometry(np.zeros(3), np.diag([1e-6, 1e-6, 1e-7]))
REAL = np.array([[2.0, 0.0], [1.0, 1.0], [1.0, -1.0], [3.0, 2.0]])
GHOST, ALL_ROUND = np.array([[2.0, -2.0]]), ViewsFrom(2.0 * np.pi, 8.0)


def walled() -> ExploredCells:
    """Free space of 10 m × 10 m about the origin, with a wall between robot and ghost."""
    cells = np.full((100, 100), FREE, np.uint8)
    cells[35:42, 55:62] = WALL
    return ExploredCells(cells, np.array([-5.0, -5.0]), 0.1)


def drive(view, sightings: int, then: int, finds=lambda *_: None, **settings) -> tuple[Slam, list[SlamStep]]:
    """A robot at rest that measures the ghost in `sightings` scans, and then only real features."""
    slam = Slam(SlamSpec(reach=8.0, **{"negative_evidence": True} | settings), view, relocate=finds)
    scans = [np.concatenate([REAL, GHOST])] * sightings + [REAL] * then
    return slam, [slam.step(STILL, Scan.from_points(points, sigma=0.02)) for points in scans]


def test_what_should_be_in_view_and_is_never_measured_is_removed_from_map_and_graph() -> None:
    slam, steps = drive(ALL_ROUND, 2, 30)
    removed = [step.removed.tolist() for step in steps]
    assert [ids for ids in removed if ids] == [[4]] and removed.index([4]) >= 2 + 5 * 3
    np.testing.assert_allclose(slam.map.positions, REAL, atol=0.05)
    assert slam.covisibility.n == slam.map.n and slam.map.seen.tolist() == [32] * 4


@pytest.mark.parametrize("view", [None, ViewsFrom(1.0, 8.0), ViewsFrom(6.28, 8.0, explored=walled())])
def test_what_may_be_out_of_view_stays(view) -> None:
    assert drive(view, 2, 60)[0].map.n == 5


def test_the_more_often_a_feature_was_seen_the_longer_it_stays() -> None:
    early, late = ([len(step.removed) for step in drive(ALL_ROUND, seen, 150)[1]].index(1) - seen for seen in (8, 16))
    assert late > early + 5 * 7 > 5 * 14
    assert drive(ALL_ROUND, 30, 200)[0].map.n == 5


def test_nothing_is_removed_without_the_setting_or_while_nobody_can_tell_that_the_robot_is_lost() -> None:
    assert drive(ALL_ROUND, 2, 60, negative_evidence=False)[0].map.n == 5
    assert drive(ALL_ROUND, 2, 60, None)[0].map.n == 5
