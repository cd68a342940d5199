"""When a scan is doubted, when the robot is lost, and when neither."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association.prediction import Prediction
from slam_gym.slam.relocate import Tracker
from slam_gym.types import UNPAIRED, BoolArray, Effort, Hypothesis, Scan

FEATURES = 10


def prediction(visibility=None) -> Prediction:
    positions = np.random.default_rng(0).uniform(-5, 5, (FEATURES, 2))
    made = Prediction.from_gaussian(positions, 0.01 * np.eye(2 * FEATURES))
    return made.with_visibility(visibility)


def paired(count: int) -> Hypothesis:
    decisions = np.where(np.arange(FEATURES) < count, np.arange(FEATURES), UNPAIRED)
    return Hypothesis(decisions, 0.0, 2 * count, Effort())


def doubts(
    tracker: Tracker, expected: Prediction, hypothesis: Hypothesis, established: BoolArray | None = None
) -> bool:
    """Whether the tracker doubts a scan that measured ahead of the robot."""
    if established is not None:
        expected.expected.sightings[:] = established
        expected = replace(expected, confirmations=1)
    scan = Scan.from_points(np.full((len(hypothesis.features), 2), [2.0, 0.0]), sigma=0.1)
    return not tracker.believes(scan, expected, hypothesis)


def test_a_scan_of_strangers_right_after_one_that_knew_its_way_is_doubted() -> None:
    tracker, out_of_view = Tracker(0.3, 3, 4), prediction(np.full(FEATURES, 0.05))
    assert not doubts(tracker, out_of_view, paired(4))
    assert doubts(tracker, out_of_view, paired(0))
    assert not doubts(tracker, out_of_view, paired(3))


def test_behind_a_door_pairings_with_features_that_are_not_established_yet_keep_doubt_away() -> None:
    out_of_view = prediction(np.full(FEATURES, 0.05))
    for count, doubted in ((3, False), (2, True)):
        tracker, newest = Tracker(0.3, 3, 4), np.where(np.arange(FEATURES) < count, 9 - np.arange(FEATURES), UNPAIRED)
        assert not doubts(tracker, out_of_view, paired(6))
        few_new = replace(paired(count), features=newest)
        assert doubts(tracker, out_of_view, few_new, np.arange(FEATURES) < 6) is doubted


def test_features_that_are_not_near_are_no_reason_to_doubt_but_find_a_lost_robot_again() -> None:
    in_view = prediction(np.full(FEATURES, 0.9))
    old = replace(in_view, expected=in_view.expected._replace(near=np.zeros(FEATURES, bool)))
    tracker = Tracker(0.3, 3, 4)
    for _ in range(20):
        assert not doubts(tracker, old, paired(0))
    while not tracker.lost:
        assert doubts(tracker, in_view, paired(0))
    assert doubts(tracker, old, paired(3)) and tracker.lost
    assert not doubts(tracker, old, paired(8)) and not tracker.lost


def test_a_scan_that_mostly_makes_sense_is_not_doubted_for_what_it_does_not_show() -> None:
    half = replace(paired(2), features=np.array([0, 1, UNPAIRED, UNPAIRED]))
    assert not doubts(Tracker(0.3, 3, 4), prediction(np.full(FEATURES, 0.9)), half)


def test_neither_are_features_that_are_not_established_nor_too_few_to_tell() -> None:
    tracker, in_view = Tracker(0.3, 1, 4), prediction(np.full(FEATURES, 0.9))
    assert not doubts(tracker, in_view, paired(0), np.zeros(FEATURES, bool))
    assert not doubts(tracker, in_view, paired(0), np.arange(FEATURES) < 3)
    assert doubts(tracker, in_view, paired(0), np.arange(FEATURES) < 4)


def test_where_the_view_is_known_few_measurements_are_not_learned_from_and_neither_add_nor_end_a_doubt() -> None:
    tracker, in_view = Tracker(0.3, 3, 4), prediction(np.full(FEATURES, 0.9))
    few = replace(paired(0), features=np.full(3, UNPAIRED))
    for doubted in (0, 1, 2):
        for _ in range(10):
            assert doubts(tracker, in_view, few) and tracker.doubted == doubted
        assert doubts(tracker, in_view, paired(0))
    assert tracker.lost


def test_the_fraction_decides_lost_after_so_many_in_a_row_and_found_only_by_a_larger_fraction() -> None:
    tracker, in_view = Tracker(0.3, 3, 4), prediction(np.full(FEATURES, 0.9))
    assert not doubts(Tracker(0.3, 3, 4), in_view, paired(3))
    for count, few in ((1, 2), (2, 0)):
        assert doubts(tracker, in_view, paired(few)) and tracker.doubted == count and not tracker.lost
    assert not doubts(tracker, in_view, paired(3)) and tracker.doubted == 0
    for _ in range(3):
        doubts(tracker, in_view, paired(0))
    assert tracker.lost
    assert doubts(tracker, in_view, paired(3)) and tracker.lost  # that many pair by chance now and then
    assert not doubts(tracker, in_view, paired(8)) and not tracker.lost


def test_a_lost_robot_stays_lost_where_nothing_is_expected() -> None:
    tracker = Tracker(0.3, 1, 4)
    doubts(tracker, prediction(np.full(FEATURES, 0.9)), paired(0))
    assert tracker.lost and doubts(tracker, prediction(np.zeros(FEATURES)), paired(0))


AHEAD = np.column_stack([np.full(FEATURES, 2.0), np.linspace(-1.0, 1.0, FEATURES)])


def facing(positions: np.ndarray) -> Prediction:
    return Prediction.from_gaussian(positions, 0.01 * np.eye(2 * FEATURES))


NOTHING = Hypothesis(np.empty(0, np.int64), 0.0, 0)  # on a scan without measurements


def looking_ahead(scans: int = 3, scale: float = 1.0) -> Tracker:
    """A tracker whose robot is lost after so many `scans`, and whose sensor has measured ahead of it only."""
    tracker = Tracker(0.3, scans, 4)
    tracker.look(scale * AHEAD)
    return tracker


def test_without_visibilities_what_was_paired_last_is_expected() -> None:
    tracker = looking_ahead()
    assert not doubts(tracker, facing(AHEAD), paired(8))
    assert doubts(tracker, facing(AHEAD), paired(0))
    unseen = looking_ahead()
    assert not doubts(unseen, facing(AHEAD), paired(3)) and not doubts(unseen, facing(AHEAD), paired(0))  # too few
    assert not doubts(looking_ahead(), facing(AHEAD), paired(0))  # nothing was paired before


def test_one_accidental_pairing_is_not_enough_where_many_features_have_disappeared() -> None:
    tracker = looking_ahead()
    assert not doubts(tracker, facing(AHEAD), paired(FEATURES)) and doubts(tracker, facing(AHEAD), paired(1))
    few = replace(paired(1), features=paired(1).features[:5])
    assert not doubts(tracker, facing(AHEAD), paired(3)) and not doubts(tracker, facing(AHEAD), few)


def test_one_pairing_on_new_ground_ends_no_doubt() -> None:
    tracker = looking_ahead(10)
    assert not doubts(tracker, facing(AHEAD), paired(FEATURES)) and not doubts(tracker, facing(-AHEAD), paired(1))
    assert not doubts(tracker, facing(AHEAD), paired(FEATURES)) and doubts(tracker, facing(AHEAD), paired(0))
    assert doubts(tracker, facing(-AHEAD), paired(1)) and not doubts(tracker, facing(-AHEAD), paired(3))


@pytest.mark.parametrize("out_of_view", [-AHEAD, 1.3 * AHEAD])
def test_what_has_gone_out_of_the_sector_is_not_missed(out_of_view: np.ndarray) -> None:
    tracker = looking_ahead()
    assert not doubts(tracker, facing(AHEAD), paired(FEATURES)) and not doubts(tracker, facing(out_of_view), paired(0))
    everywhere = looking_ahead()
    everywhere.look(-AHEAD)
    assert not doubts(everywhere, facing(AHEAD), paired(FEATURES)) and doubts(everywhere, facing(-AHEAD), paired(0))


@pytest.mark.parametrize(("scale", "by_chance"), [(1.0, True), (20.0, False)])  # scattered: no pairing is accidental
def test_pairings_that_chance_may_explain_are_no_proof_and_eight_scans_of_them_are_lost(scale, by_chance) -> None:
    missing, tracker, spread = looking_ahead(scale=scale), looking_ahead(scale=scale), facing(scale * AHEAD)
    assert not doubts(missing, spread, paired(FEATURES)) and doubts(missing, spread, paired(2)) is by_chance
    assert not any(doubts(tracker, spread, paired(2)) for _ in range(7))
    assert doubts(tracker, spread, paired(2)) is by_chance and tracker.lost is by_chance


def test_slip_is_suspected_where_pairings_are_few_or_without_a_view_fit_badly_and_needs_most_of_the_scan() -> None:
    tracker, ahead, scan = looking_ahead(), facing(AHEAD), Scan.from_points(AHEAD, sigma=0.1)
    assert not doubts(tracker, ahead, paired(FEATURES))
    badly = replace(paired(8), joint_distance=100.0)
    for made, with_view in ((ahead, False), (ahead.with_visibility(np.ones(FEATURES)), True)):
        assert tracker.suspects_slip(scan, made, paired(0)) and not tracker.suspects_slip(scan, made, paired(8))
        assert tracker.suspects_slip(scan, made, badly) is not with_view
    assert tracker.suspects_slip(scan, ahead, paired(4)) and not tracker.suspects_slip(scan, ahead, paired(5))
    assert not any(doubts(tracker, ahead, paired(4)) for _ in range(tracker.scans))
    assert not tracker.suspects_slip(scan, ahead, paired(4))  # most measurements are always spurious
    assert not doubts(tracker, ahead, paired(FEATURES)) and tracker.suspects_slip(scan, ahead, paired(4))
    for made, least in ((ahead, 8), (ahead.with_visibility(np.ones(FEATURES)), 5)):
        for after, confirmed in ((paired(least), True), (paired(least - 1), False), (badly, False)):
            assert tracker.confirms_slip(scan, (made, paired(0)), (made, after)) is confirmed
        assert not tracker.confirms_slip(scan, (made, paired(least + 1)), (made, paired(least)))


def test_a_doubt_stands_until_a_scan_pairs_something() -> None:
    tracker = looking_ahead()
    assert not doubts(tracker, facing(AHEAD), paired(FEATURES))
    assert doubts(tracker, facing(AHEAD), paired(0)) and doubts(tracker, facing(-AHEAD), paired(0))
    assert doubts(tracker, facing(AHEAD), NOTHING) and tracker.doubted == 2
    assert not doubts(tracker, facing(-AHEAD), paired(6))


@pytest.mark.parametrize("visibility", [None, np.full(FEATURES, 0.3)])
def test_what_was_paired_is_still_expected_after_a_scan_without_measurements(visibility) -> None:
    tracker, ahead = looking_ahead(), facing(AHEAD).with_visibility(visibility)
    assert not doubts(tracker, ahead, paired(FEATURES)) and not doubts(tracker, ahead, NOTHING)
    assert doubts(tracker, ahead, paired(0))


def test_what_the_last_scan_paired_is_followed_through_removals() -> None:
    out_of_view, gone = prediction(np.full(FEATURES, 0.05)), np.full(FEATURES, UNPAIRED)
    for became, doubted in ((np.arange(FEATURES), True), (gone, False)):
        tracker = Tracker(0.3, 3, 4)
        assert not doubts(tracker, out_of_view, paired(5))
        tracker.renumber(became)
        assert doubts(tracker, out_of_view, paired(0)) is doubted


def test_in_another_map_nothing_is_expected_of_the_last_one() -> None:
    tracker, ahead = looking_ahead(scans=1), facing(AHEAD)
    assert not doubts(tracker, ahead, paired(5)) and doubts(tracker, ahead, paired(0)) and tracker.lost
    tracker.forget()
    assert not tracker.lost and not doubts(tracker, ahead, paired(0))
    assert not any(doubts(tracker, ahead, paired(2)) for _ in range(6))  # with the last scan, seven are accidental
    tracker.forget()
    assert not doubts(tracker, ahead, paired(2))  # the first in this map, not the eighth
