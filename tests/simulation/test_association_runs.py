"""Runs that are associated from outside: the scans do not depend on what is made of them, and the books are right."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import jcbb, nearest_neighbour, true_association
from slam_gym.association.prediction import Prediction
from slam_gym.geometry import observe
from slam_gym.metrics.map_quality import map_error
from slam_gym.scenarios import overridden
from slam_gym.simulation.association_runs import (
    CORRIDOR,
    DRIVERS,
    DrivenRun,
    LoggedRun,
    nearest_frontier,
    random_goal,
)
from slam_gym.simulation.goals import FRONTIERS, LOOK, SLOTS, Goals
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam
from slam_gym.types import UNPAIRED, Effort, Hypothesis, Scan
from slam_gym.world import corridor
from tests.simulation.episodes import SMALL, site_of


def refuse_all(scan: Scan, prediction: Prediction) -> Hypothesis:
    return Hypothesis(np.full(len(scan), UNPAIRED), 0.0, 0, Effort())


def play(run, associator, scans: int = 10**6) -> list[Scan]:
    """Associate to the end, or for so many scans; the scans."""
    seen = []
    while not run.over and len(seen) < scans:
        run.next_scan()
        seen.append(run.scan)
        run.associate(associator(run.scan, run.prediction))
    return seen


def logged(seed: int = 0, **changes) -> LoggedRun:
    return LoggedRun(replace(CORRIDOR, **changes), np.random.default_rng(seed))


def driven(driver: str = "nearest_frontier", seed: int = 0) -> DrivenRun:
    return DrivenRun(SMALL, site_of(SMALL), DRIVERS[driver], np.random.default_rng(seed))


def assert_same_scans(some: list[Scan], others: list[Scan]) -> None:
    assert len(some) == len(others) > 0
    for one, other in zip(some, others):
        np.testing.assert_array_equal(one.points, other.points)
        np.testing.assert_array_equal(one.covariances, other.covariances)


# --- logs -------------------------------------------------------------------------------------------------------------


def test_the_scans_of_a_log_are_the_same_whatever_the_hypotheses() -> None:
    expected = [scan for _, scan, _ in corridor.walk_round(np.random.default_rng(3))]
    for associator in (jcbb, nearest_neighbour, refuse_all):
        assert_same_scans(play(logged(3), associator), expected)
    assert any(not np.array_equal(a.points, b.points) for a, b in zip(expected, play(logged(4), refuse_all)))


def test_a_logged_run_is_slam_over_the_log_judged() -> None:
    run, judged = logged(1), JudgedSlam(Slam(CORRIDOR.slam), "jcbb")
    play(run, jcbb)
    for odometry, scan, truth in corridor.walk_round(np.random.default_rng(1)):
        judged.step(odometry, scan, truth)
    np.testing.assert_array_equal(run.slam.map.mean, judged.slam.map.mean)
    assert run.identities.total == judged.tally and run.over
    assert run.scans == run.length == CORRIDOR.length == len(run.poses) == len(run.estimates) == 45


def test_its_map_is_measured_in_its_own_base() -> None:
    """With right associations it is good wherever in the frame of the log the run began, and empty at the start."""
    start, errors = np.array([3.0, -1.0, 0.8]), []

    def moved(rng):
        for odometry, scan, truth in CORRIDOR.scans(rng):
            pose = np.array([*observe(start, truth.pose[None, :2])[0], truth.pose[2] - start[2]])
            yield odometry, scan, replace(truth, pose=pose)

    run = logged(2, targets=observe(start, CORRIDOR.targets), scans=moved)
    while not run.over:
        run.next_scan()
        known = run.identities.source_of(run.slam.map.ids)
        run.associate(true_association(run.scan, run.prediction, sources=run.truth.sources, identities=known))
        errors.append(run.map_error())
    np.testing.assert_allclose(run.targets, CORRIDOR.targets, atol=1e-9)
    assert errors[0] == 1.0 and errors[-1] < 0.5
    assert errors[-1] == map_error(run.slam.map.confirmed, run.targets, CORRIDOR.prior_sigma)


def test_a_log_that_is_shorter_than_it_says_is_refused_by_name() -> None:
    run = logged(length=47)
    with pytest.raises(ValueError, match="log 'corridor': ends after 45 scans, not 47"):
        play(run, refuse_all)
    with pytest.raises(ValueError, match=r"ScanLog.length: 0 is less than 1"):
        replace(CORRIDOR, length=0)


def test_a_log_that_says_so_is_over_before_its_scans_are() -> None:
    assert len(play(logged(length=7), jcbb)) == 7


# --- driven -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_driven_run_lasts_as_long_as_its_scenario_and_is_the_same_each_time(driver: str) -> None:
    one, other = driven(driver), driven(driver)
    scans = play(one, jcbb)
    assert_same_scans(scans, play(other, jcbb))
    assert one.over and one.scans == one.length == SMALL.budget + 1 and len(scans) == SMALL.budget
    assert one.map_error() < 1.0
    np.testing.assert_array_equal(one.slam.map.mean, other.slam.map.mean)
    travelled = np.hypot(*np.diff(np.array(one.poses)[:, :2], axis=0).T).sum()
    assert travelled > 1.0


def test_nobody_is_carried_away_since_nothing_would_relocate_the_robot() -> None:
    kidnapped = overridden(SMALL, {"kidnapping.at": 0.5})
    run = DrivenRun(kidnapped, site_of(SMALL), DRIVERS["random"], np.random.default_rng(0))
    play(run, jcbb)
    assert np.hypot(*np.diff(np.array(run.poses)[:, :2], axis=0).T).max() < 0.3


# --- drivers ----------------------------------------------------------------------------------------------------------


def goals(*legal: int) -> Goals:
    mask = np.zeros(SLOTS, np.bool_)
    mask[list(legal)] = True
    return Goals(np.zeros((SLOTS, 2)), np.zeros(SLOTS), np.zeros(SLOTS), np.zeros(SLOTS), mask)


def test_the_nearest_frontier_comes_first_then_any_revisit_then_a_look_around() -> None:
    rng, revisits = np.random.default_rng(0), (1 + FRONTIERS, 3 + FRONTIERS)
    assert nearest_frontier(goals(LOOK, 1, 2, *revisits), rng) == 1
    assert {nearest_frontier(goals(LOOK, *revisits), rng) for _ in range(50)} == set(revisits)
    assert nearest_frontier(goals(LOOK), rng) == LOOK


def test_a_random_goal_is_any_legal_one() -> None:
    rng, legal = np.random.default_rng(0), (LOOK, 2, 1 + FRONTIERS)
    assert {random_goal(goals(*legal), rng) for _ in range(100)} == set(legal)
