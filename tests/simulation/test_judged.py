"""SLAM that is judged: the twin of a loop written by hand, and who gets to see the truth."""

import numpy as np
import pytest

from slam_gym.association import true_association
from slam_gym.metrics.association import Identities, Tally
from slam_gym.simulation.judged import CEILING, JudgedSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import SPURIOUS, Odometry, Scan, Truth
from tests.recordings import looks

LOG = looks(0, 15)


def test_it_is_a_loop_of_steps_and_judgements() -> None:
    judged, slam, identities = JudgedSlam(Slam(), "jcbb"), Slam(), Identities()
    for odometry, scan, truth in LOG:
        step = judged.step(odometry, scan, truth)
        by_hand = slam.step(odometry, scan, "jcbb")
        identities.judge(by_hand, truth)
        np.testing.assert_array_equal(step.ids, by_hand.ids)
        assert judged.identities.total == identities.total
        np.testing.assert_array_equal(judged.identities.decisions, identities.decisions)
    np.testing.assert_array_equal(judged.slam.map.mean, slam.map.mean)
    assert judged.tally == identities.total != Tally()


# --- who is told the truth --------------------------------------------------------------------------------------------


def renamed(truth: Truth) -> Truth:
    """The same truth about the poses, and a lie about every source."""
    return Truth(truth.pose, np.where(truth.sources < 0, truth.sources, (truth.sources + 1) % 40))


def test_the_truth_is_told_to_its_associator_by_name_scan_after_scan() -> None:
    honest, lied_to = JudgedSlam(Slam(), CEILING), JudgedSlam(Slam(), CEILING)
    for number, (odometry, scan, truth) in enumerate(LOG):
        honest.step(odometry, scan, truth)
        lied_to.step(odometry, scan, truth if number < 5 else renamed(truth))
    assert honest.tally.fp == honest.tally.fn == 0 < honest.tally.tp
    positions = honest.slam.map.positions[:, None]
    assert np.hypot(*(positions - lied_to.slam.map.positions[None]).transpose(2, 0, 1)).min(axis=1).max() > 0.2


@pytest.mark.parametrize("associator", [true_association, "slam_gym.association:true_association"])
def test_its_function_by_any_other_way_is_told_nothing(associator) -> None:
    judged = JudgedSlam(Slam(), associator)
    with pytest.raises(ValueError, match="true sources"):
        judged.step(*LOG[0])
    assert judged.tally == Tally()


# --- what the map is told ---------------------------------------------------------------------------------------------


def test_informed_every_labelled_feature_goes_in_when_it_is_first_seen_and_nothing_else_does() -> None:
    """Side by side, the second feature would be taken for the first by the rule of `Slam`."""
    still = Odometry.from_motion([0, 0, 0], 0.001)
    first = Scan.from_points([[2, 0]], sigma=0.05)
    second = Scan.from_points([[2, 0], [2.04, 0], [-3, 0], [4, 4]], sigma=0.05)
    sources = np.array([0, 1, SPURIOUS, 1])
    created = {}
    for informed in (False, True):
        judged = JudgedSlam(Slam(SlamSpec(reach=9.0)), CEILING, informed=informed)
        judged.step(still, first, Truth(np.zeros(3), np.array([0])))
        created[informed] = judged.step(still, second, Truth(np.zeros(3), sources)).created.tolist()
    assert created[True] == [False, True, False, False]
    assert created[False] == [False, False, True, True]
