"""Loops that close and maps that are joined, on drives round a block; and nothing changes while nothing is wrong."""

import math
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association.prediction import StartRule
from slam_gym.geometry import relative
from slam_gym.mapping.linear_algebra import is_covariance
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.places.recognition import RecognitionSpec
from slam_gym.slam.slam import STILL, Slam, SlamSpec
from slam_gym.types import NO_ID, IntArray, Odometry, Scan
from tests.slam.rings import RADIUS, REACH, VIEW, Drive, drive, duplicates, look, map_it, ring_of_landmarks

SPEC = SlamSpec(MapSpec(unconfirmed_age=20), new_confidence=1.0 - 1e-6)

EARLY = replace(SPEC, max_accidental_matches=0.1)
"""So small a ring and so great a drift: old features are left to the loops early."""


def nobody(*_: object) -> None:
    """A relocation that never finds anything."""


def fused(slam: Slam, kind: str) -> list[IntArray]:
    """Pairs (k, 2) of ids of each fusion of that kind."""
    assert slam.atlas is not None
    return [record.ids for record in slam.atlas.fusions if record.kind == kind]


def loop_drive(seed: int, steps: int = 300, carried_at: int | None = None, drift: float = 0.03) -> Drive:
    rng = np.random.default_rng(seed)
    return drive(ring_of_landmarks(rng), rng, steps, drift, carried_at)


def sources_differ(judged: JudgedSlam, closed: list[IntArray]) -> int:
    """How many of the pairs that were made equal were not."""
    of = judged.identities.source_of
    return sum(int((of(ids[:, 0]) != of(ids[:, 1])).sum()) for ids in closed)


def assert_valid(slam: Slam, kind: str) -> None:
    """Of a map in which something was fused."""
    m, graph = slam.map, slam.covisibility
    assert is_covariance(m.covariance)
    np.testing.assert_array_equal(m.covariance, m.covariance.T)
    assert graph.n == m.n and len(np.unique(m.ids)) == m.n
    pairs, counts = graph.edges()
    assert (counts > 0).all() and (pairs[:, 0] < pairs[:, 1]).all()
    assert (counts <= np.minimum(m.seen[pairs[:, 0]], m.seen[pairs[:, 1]])).all()
    for ids in fused(slam, kind):
        assert (ids[:, 0] < ids[:, 1]).all() and not np.isin(ids[:, 1], m.ids).any()  # the older id stays


def test_a_loop_is_closed_and_what_was_drawn_twice_is_gone() -> None:
    errors = []
    for seed in range(4):
        log = loop_drive(seed)
        plain, without = map_it(Slam(SPEC), log)
        slam = Slam(EARLY, VIEW, relocate=nobody, atlas=AtlasSpec())
        judged, error = map_it(slam, log)
        assert fused(slam, "loop") and sources_differ(judged, fused(slam, "loop")) == 0, f"seed {seed}"
        assert duplicates(judged) <= 1, f"seed {seed}"
        assert_valid(slam, "loop")
        errors.append((without, error, duplicates(plain)))
    without, error, left = np.array(errors).T
    assert error.mean() < 0.8 * without.mean() and left.mean() > 5.0


def test_a_robot_that_was_carried_away_goes_on_in_a_second_map_and_the_two_are_joined() -> None:
    for seed in range(4):
        slam = Slam(EARLY, VIEW, relocate=nobody, atlas=AtlasSpec())
        judged, _ = map_it(slam, loop_drive(seed, 340, 100, 0.014))
        joined = fused(slam, "maps")
        assert len(joined) == 1 == len(slam.maps), f"seed {seed}"
        assert sources_differ(judged, joined) == 0 and slam.relocations == 1
        assert is_covariance(slam.map.covariance) and slam.covisibility.n == slam.map.n
        assert duplicates(judged) <= 3, f"seed {seed}"
        assert judged.tally.precision > 0.95


def test_nothing_changes_to_the_last_bit_while_nothing_is_found() -> None:
    log = loop_drive(0, 200, drift=0.004)
    everything = replace(SPEC, max_accidental_matches=1e9)
    plain, atlas = Slam(SPEC, relocate=nobody), Slam(everything, relocate=nobody, atlas=AtlasSpec())
    for odometry, scan, _ in log.steps:
        one, other = plain.step(odometry, scan), atlas.step(odometry, scan)
        np.testing.assert_array_equal(one.ids, other.ids)
    assert not fused(atlas, "loop") and not fused(atlas, "maps")
    np.testing.assert_array_equal(plain.map.mean, atlas.map.mean)
    np.testing.assert_array_equal(plain.map.covariance, atlas.map.covariance)


def test_who_weighs_all_hypotheses_is_offered_everything_and_maps_as_without_an_atlas() -> None:
    """It would take for new what it is not offered."""
    log, maps = loop_drive(2, 250), []
    for slam in (Slam(SPEC), Slam(EARLY, relocate=nobody, atlas=AtlasSpec())):
        for odometry, scan, _ in log.steps:
            slam.step(odometry, scan, "marginal")
        maps.append(slam.map)
    assert len(maps[0]) > 20
    np.testing.assert_array_equal(maps[0].mean, maps[1].mean)


def test_ambiguous_features_are_withheld_again_after_a_scan_of_an_associator_that_weighs_all_hypotheses() -> None:
    slams = [Slam(EARLY, VIEW, relocate=nobody, atlas=AtlasSpec()) for _ in range(2)]
    for k, (odometry, scan, _) in enumerate(loop_drive(2, 250).steps):
        slams[0].step(odometry, scan, "jcbb")
        slams[1].step(odometry, scan, "jcbb" if k else "marginal")
    assert len(slams[0].map) > 20
    np.testing.assert_array_equal(slams[0].map.mean, slams[1].map.mean)


def test_the_true_association_is_offered_everything_and_none_of_its_pairings_is_rejected() -> None:
    log = loop_drive(2, 250)
    rejecting = replace(EARLY, max_chance_probability=0.05, trust_marginals=False)
    slams = (Slam(SPEC), Slam(rejecting, relocate=nobody, atlas=AtlasSpec()))
    judged = [map_it(slam, log, "true_association")[0] for slam in slams]
    assert [duplicates(one) for one in judged] == [0, 0] and judged[1].tally.recall == 1.0
    np.testing.assert_array_equal(slams[0].map.mean, slams[1].map.mean)


def test_where_loops_shall_find_what_is_kept_from_pairing_all_associators_go_by_one_rule() -> None:
    rejecting, kept = replace(EARLY, max_chance_probability=0.05, trust_marginals=False), []
    for seed in range(4):
        log = loop_drive(seed)
        by_itself, by_rule = (Slam(spec, VIEW, relocate=nobody, atlas=AtlasSpec()) for spec in (EARLY, rejecting))
        (without, _), (judged, _) = (map_it(slam, log, "marginal") for slam in (by_itself, by_rule))
        assert fused(by_rule, "loop") and sources_differ(judged, fused(by_rule, "loop")) == 0, f"seed {seed}"
        assert not fused(by_itself, "loop") and duplicates(judged) <= 1, f"seed {seed}"
        kept.append(duplicates(without))
    assert max(kept) > 5


@pytest.mark.parametrize("associator, rule", [("jcbb", StartRule.FITS_NOTHING), ("marginal", StartRule.ASSOCIATOR)])
def test_a_pairing_that_is_rejected_updates_and_starts_nothing(associator: str, rule: StartRule) -> None:
    """Landmarks stand in pairs, so that one old feature is no proof."""
    rng = np.random.default_rng(3)
    landmarks = ring_of_landmarks(rng)
    log = drive(np.concatenate([landmarks, landmarks + 0.5]), rng, 330, 0.02)
    specs = [replace(SPEC, max_accidental_matches=1e9, max_chance_probability=most) for most in (1.0, 0.05)]
    believing, waiting = (Slam(spec, VIEW, relocate=nobody, atlas=AtlasSpec()) for spec in specs)
    for odometry, scan, _ in log.steps:
        paired, held = (slam.step(odometry, scan, associator) for slam in (believing, waiting))
        if (paired.ids != held.ids).any():
            break
    rejected = (held.ids == NO_ID) & (paired.ids != NO_ID)
    assert rejected.any() and not held.created[rejected].any() and held.rule is rule
    assert held.hypothesis.dof == 2 * held.hypothesis.pairings
    assert 0.0 < held.hypothesis.joint_distance < paired.hypothesis.joint_distance
    assert Slam(SPEC).step(odometry, scan, "marginal").rule is StartRule.ASSOCIATOR
    by_rule = Slam(replace(SPEC, trust_marginals=False), relocate=nobody, atlas=AtlasSpec())
    assert by_rule.step(odometry, scan, "marginal").rule is StartRule.FITS_NOTHING


@pytest.mark.parametrize("view", [VIEW, None], ids=["view", "no view"])
@pytest.mark.parametrize("seed", range(4))
def test_a_robot_that_maps_a_place_twice_says_so_and_an_atlas_closes_the_loop_by_the_place_alone(
    seed: int, view: ViewsFrom | None
) -> None:
    sound, log = loop_drive(seed, 450, None, 0.001), loop_drive(seed, 450, 200, 0.001)
    spec = SlamSpec(reach=REACH, lost_fraction=0.0)
    known, carried, slam = (Slam(spec, view, relocate=nobody, atlas=atlas) for atlas in (None, None, AtlasSpec()))
    assert duplicates(map_it(known, sound)[0]) <= 10 and not known.missed_loop
    plain, without = map_it(carried, log)
    assert duplicates(plain) > 10 and carried.missed_loop
    by_itself = Slam(SlamSpec(reach=REACH), view)
    map_it(by_itself, log)
    assert by_itself.missed_loop == (view is not None)  # without a view, the sector is that of the tracker
    judged, error = map_it(slam, log)
    assert fused(slam, "loop") and sources_differ(judged, fused(slam, "loop")) == 0
    assert duplicates(judged) < 0.6 * duplicates(plain) and error < without
    assert_valid(slam, "loop")


@pytest.mark.parametrize("moved", [0.0, 0.8])
def test_a_wrong_pairing_with_one_old_feature_does_not_hide_that_those_around_it_are_missing(moved: float) -> None:
    place = np.random.default_rng(0).uniform(1.0, 4.0, (12, 2))
    copy, slam = place + np.outer(np.arange(12) > 0, [0.0, moved]), Slam(SlamSpec(lost_fraction=0.0), VIEW)
    for step in range(350):
        slam.step(STILL, Scan.from_points(place if step < 50 else copy, sigma=0.02), "nearest_neighbour")
    assert slam.missed_loop == (moved > 0.0)


def test_features_that_something_hides_are_no_missed_loop_while_others_of_the_place_are_measured() -> None:
    place, slam = np.random.default_rng(0).uniform(1.0, 4.0, (18, 2)), Slam(SlamSpec(lost_fraction=0.0), VIEW)
    for step in range(350):
        slam.step(STILL, Scan.from_points(place if step < 50 else place[:12], sigma=0.02), "nearest_neighbour")
    assert len(slam.map) == 18 and not slam.missed_loop


def test_where_the_view_is_unknown_no_feature_is_missed_that_walls_have_always_hidden_from_here() -> None:
    """The robot drives round a block, and then round it again in the next corridor, behind a wall."""
    rng, slam, hidden = np.random.default_rng(0), Slam(SlamSpec(), relocate=nobody), 0
    landmarks, pose = ring_of_landmarks(rng), np.array([RADIUS, 0.0, math.pi / 2.0])
    for angle in np.linspace(0.0, 4.0 * math.pi, 500):
        scale = 1.0 if angle < 2.0 * math.pi else 1.4
        radius, before = scale * RADIUS, pose
        pose = np.array([radius * math.cos(angle), radius * math.sin(angle), angle + math.pi / 2.0])
        odometry = Odometry.from_motion(relative(before, pose), [0.01, 0.01, 0.001])
        step = slam.step(odometry, look(scale * landmarks, pose, rng)[0])
        old = step.prediction.ages > 100
        hidden += int((old & slam.tracker.in_sector(step.prediction.positions)).sum())
    assert hidden > 400 and len(slam.map) > 170 and not slam.missed_loop


def test_without_patience_there_is_one_map_only() -> None:
    log, slam = loop_drive(0, 160, 100, 0.014), Slam(SPEC, VIEW, relocate=nobody, atlas=AtlasSpec(patience=None))
    map_it(slam, log)
    assert slam.lost and slam.maps == (slam.map,)


def test_no_scan_is_searched_for_twice_in_one_map() -> None:
    searches = []

    def search(scan: Scan, m: StochasticMap, *_: object) -> None:
        searches.append((id(scan), int(m.ids[0])))

    log = loop_drive(0, 160, 100, 0.014)
    map_it(Slam(EARLY, VIEW, relocate=search, atlas=AtlasSpec(rejoin=1)), log)
    assert len(searches) == len(set(searches)) > 8


def test_a_map_too_small_to_be_recognised_is_dropped() -> None:
    log, spec = loop_drive(0, 60, 30, 0.014), AtlasSpec(RecognitionSpec(min_pairs=100, group=100), patience=0)
    slam = Slam(SPEC, VIEW, relocate=nobody, atlas=spec)
    removed = []
    for odometry, scan, _ in log.steps:
        removed.append(len(slam.step(odometry, scan).removed))
        assert not slam.lost  # without patience, the other map begins in the scan in which the robot gets lost
    assert max(removed) > 8 and slam.maps == (slam.map,)


def test_an_atlas_without_relocation_is_refused() -> None:
    with pytest.raises(ValueError, match="atlas"):
        Slam(SPEC, atlas=AtlasSpec())
