"""Local maps on the corridor, what joins them, and how features that two maps hold are found."""

import functools

import numpy as np
import pytest
from scipy.stats import chi2

from slam_gym.geometry import compose, relative, wrap_angle
from slam_gym.mapping.locality import locality_sizes
from slam_gym.mapping.map_joining import join
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.metrics.consistency import nees
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.local_maps import LocalMapSlam, Match, jointly_compatible
from slam_gym.slam.slam import STILL, Slam, SlamSpec
from slam_gym.types import Array, IntArray, Odometry, Scan
from slam_gym.world import corridor
from tests.oracles.association import gate
from tests.slam.places.test_verification import parts

WORLD = corridor.features()


class Loop:
    """One loop through the corridor of the reference experiment in local maps."""

    def __init__(
        self, seed: int, features_per_map: int | None, *, truth: bool = True, match: Match | None = None
    ) -> None:
        rng = np.random.default_rng(seed)
        spec = SlamSpec(MapSpec(unconfirmed_age=None), reach=corridor.RANGE)
        self.slam = LocalMapSlam(spec, features_per_map, match)
        judged = JudgedSlam(self.slam, "true_association" if truth else "jcbb")
        self.identities = judged.identities
        self.pose, self.starts, self.views, self.scans = np.zeros(3), [np.zeros(3)], [], []
        for odometry, scan, seen in corridor.walk_round(rng):
            self.pose = seen.pose
            self.scans.append(seen.sources)
            before = len(self.slam.maps)
            judged.step(odometry, scan, seen)
            if len(self.slam.maps) > before:
                self.starts.append(self.pose)  # true pose of the base
                self.views.append(seen.sources)
        self.tally = judged.tally

    def joined_error(self) -> tuple[Array, Array, Array]:
        """Error of the joined map (robot, oldest feature of each source), its covariance, source of every feature."""
        m = self.slam.joined()
        sources = self.identities.source_of(m.ids)
        _, first = np.unique(sources, return_index=True)
        entries = np.concatenate([np.arange(3), (3 + 2 * first[:, None] + np.arange(2)).ravel()])
        error = m.mean[entries] - np.concatenate([self.pose, WORLD[sources[first]].ravel()])
        error[2] = wrap_angle(error[2])
        return error, np.ascontiguousarray(m.covariance[np.ix_(entries, entries)]), sources


@functools.cache
def loop(seed: int, features_per_map: int | None, truth: bool = True) -> Loop:
    return Loop(seed, features_per_map, truth=truth)


def test_maps_are_closed_when_full_and_start_certain_where_the_last_one_ended() -> None:
    slam, starts = loop(0, 20).slam, loop(0, 20).starts
    assert len(slam.maps) > 5 and all(20 <= closed.n < 40 for closed in slam.maps[:-1])
    for base, start in zip(slam.bases, starts):
        np.testing.assert_allclose(base[:2], start[:2], atol=2.0)
    for closed, base, after in zip(slam.maps, slam.bases, slam.bases[1:]):
        np.testing.assert_allclose(relative(base, after), closed.pose, atol=1e-12)
    np.testing.assert_array_equal(slam.bases[0], np.zeros(3))
    np.testing.assert_allclose(slam.pose, compose(slam.bases[-1], slam.map.pose))


def test_the_joined_map_is_consistent_and_has_few_duplicates() -> None:
    total, dofs, duplicates = 0.0, 0, 0
    for seed in range(8):
        error, covariance, sources = loop(seed, 30).joined_error()
        total, dofs = total + nees(error, covariance), dofs + len(error)
        duplicates += len(sources) - len(np.unique(sources))
        assert len(np.unique(sources)) == len(WORLD)
    low, high = chi2.ppf([0.0005, 0.9995], dofs) / dofs
    assert low - 0.05 < total / dofs < high + 0.05  # linearisation at headings degrees off
    assert duplicates <= 8  # of 8 × 88 features


def test_with_its_own_associations_it_maps_like_one_filter() -> None:
    """Median over loops, for both lose a loop now and then."""
    errors = []
    for seed in range(7):
        run = loop(seed, 30, truth=False)
        error, _, _ = run.joined_error()
        errors.append(np.sqrt((error[3:] ** 2).reshape(-1, 2).sum(axis=1).mean()))
        assert run.tally.precision > 0.95
    assert np.median(errors) < 0.06


def test_identities_hold_in_each_map_and_in_the_joined_one() -> None:
    """With right associations every decision is right, though each map begins its features anew."""
    run = loop(0, 20)
    tally = run.tally
    assert tally.fp == tally.fn == tally.new_wrong == 0 and tally.tp > 100
    assert tally.new_right == sum(m.n for m in run.slam.maps)
    joined = run.slam.joined()
    np.testing.assert_allclose(joined.positions, WORLD[run.identities.source_of(joined.ids)], atol=1.0)


def test_locality_is_the_local_map_a_feature_was_first_seen_in() -> None:
    run = loop(0, 20)
    joined = run.slam.joined()
    numbers = run.slam.map_of(joined)
    for number, m in enumerate(run.slam.maps):
        assert set(joined.ids[numbers == number].tolist()) <= set(m.ids.tolist())
        assert (run.slam.map_of(m) == number).all()
    sizes = locality_sizes(run.slam.locality(joined), joined.n)
    assert sizes.max() <= max(m.n for m in run.slam.maps)


def test_covisibility_goes_over_into_the_joined_map() -> None:
    """With right associations: exactly the pairs of true features that some scan saw, but for duplicates left over."""
    run = loop(0, 20)
    joined = run.slam.joined()
    sources = run.identities.source_of(joined.ids)
    once = np.flatnonzero([(sources == s).sum() == 1 for s in sources])
    expected = np.eye(joined.n, dtype=np.bool_)
    for scan in run.scans:
        in_view = np.isin(sources, scan)
        expected |= in_view[:, None] & in_view
    locality = run.slam.covisible(joined)
    found = np.array([np.isin(np.arange(joined.n), locality.of(j)) for j in range(joined.n)])
    assert len(once) > 80
    np.testing.assert_array_equal(found[np.ix_(once, once)], expected[np.ix_(once, once)])
    assert locality_sizes(run.slam.covisible(joined, hops=2), joined.n).mean() > found.sum(axis=1).mean()
    run.slam.step(STILL, Scan.from_points([[90.0, 90.0], [80.0, 80.0]], sigma=0.1))  # what is new is in no joined map
    np.testing.assert_array_equal(run.slam.covisible(joined).members, locality.members)
    joined.remove(np.array([0]))
    with pytest.raises(ValueError, match="m: not the map"):
        run.slam.covisible(joined)


def test_joining_leaves_each_feature_once_under_its_oldest_id_and_closed_maps_are_joined_once() -> None:
    calls: list[int] = []

    def match(m: StochasticMap, older: IntArray, newer: IntArray) -> IntArray:
        calls.append(len(newer))
        if interrupted and len(calls) == 3:
            raise KeyboardInterrupt
        sources = run.identities.source_of(m.ids)
        first = {int(source): int(j) for j, source in zip(older[::-1], sources[older[::-1]])}
        pairs = [(first[int(sources[i])], int(i)) for i in newer if int(sources[i]) in first]
        return np.array(pairs, np.int64).reshape(-1, 2)

    interrupted, run = True, Loop(0, 20, match=match)
    with pytest.raises(KeyboardInterrupt):
        run.slam.joined()
    interrupted = False  # nothing is half joined
    calls.clear()
    joined, compared = run.slam.joined(), len(calls)
    sources, ids = run.identities.source_of(joined.ids), np.concatenate([m.ids for m in run.slam.maps])
    assert compared >= len(run.slam.maps) - 1 and len(np.unique(sources)) == len(sources)
    for source, i in zip(sources, joined.ids):
        assert i == ids[run.identities.source_of(ids) == source].min()
    joined.remove(np.arange(joined.n))  # what was handed out is no window
    assert run.slam.joined().n == len(sources)
    assert set(calls[compared:]) <= set(range(run.slam.map.n + 1))
    assert len(calls) - compared < len(run.slam.maps)  # the current map alone is compared again, with each at most once


def test_the_whole_can_be_had_without_its_full_covariance() -> None:
    run = loop(0, 20)
    joined, smoothed = run.slam.joined(), run.slam.smoothed()
    np.testing.assert_array_equal(smoothed.ids, joined.ids)
    np.testing.assert_allclose(smoothed.positions, joined.positions, atol=1e-9)
    np.testing.assert_allclose(smoothed.poses[-1], joined.pose, atol=1e-9)
    np.testing.assert_allclose(smoothed.poses[:-1, :2], run.slam.bases[:, :2], atol=2.0)
    rows = np.r_[0:3, 3 + 2 * 7 : 5 + 2 * 7]
    some = smoothed.covariance([len(run.slam.maps)], joined.ids[[7]])
    np.testing.assert_allclose(some, joined.covariance[np.ix_(rows, rows)], atol=1e-9)
    assert locality_sizes(run.slam.covisible(smoothed), joined.n).min() > 0


def test_one_map_is_plain_slam() -> None:
    local, plain = LocalMapSlam(SlamSpec(), None), Slam(SlamSpec())
    for odometry, scan, _ in corridor.walk_round(np.random.default_rng(5)):
        ours, theirs = local.step(odometry, scan), plain.step(odometry, scan)
        np.testing.assert_array_equal(ours.ids, theirs.ids)
        np.testing.assert_array_equal(ours.removed, theirs.removed)
    assert len(local.maps) == 1
    np.testing.assert_array_equal(local.joined().mean, plain.map.mean)
    np.testing.assert_array_equal(local.pose, plain.map.pose)


def test_a_bad_scan_is_refused_before_a_new_map_begins() -> None:
    slam = LocalMapSlam(SlamSpec(), 1)
    still, unknown = Odometry(np.zeros(3), 1e-4 * np.eye(3)), np.full(1, np.nan)
    good = Scan(np.ones((1, 2)), np.eye(2)[None], unknown, unknown)
    slam.step(still, good)
    before = slam.map.pose_covariance
    with pytest.raises(ValueError, match="measurement 0"):
        slam.step(still, Scan(np.full((1, 2), np.nan), np.eye(2)[None], unknown, unknown))
    with pytest.raises(ValueError, match="odometry: Scan, expected Odometry"):
        slam.step(good, still)
    assert len(slam.maps) == 1
    np.testing.assert_array_equal(slam.map.pose_covariance, before)
    with pytest.raises(ValueError, match="features_per_map"):
        LocalMapSlam(SlamSpec(), 0)


# --- what two maps hold -----------------------------------------------------------------------------------------------


def two_maps(rng: np.random.Generator, shared: int, own: int) -> tuple[StochasticMap, IntArray]:
    """A join of two small crowded maps, and the true pairs."""
    landmarks = np.array([2.0, 0.0]) + rng.uniform(-3.0, 3.0, (shared + 2 * own, 2))
    base = np.array([0.3, -0.2, 0.1])
    groups = [np.arange(shared + own), np.concatenate([np.arange(shared), np.arange(shared + own, len(landmarks))])]
    Q, sigma, maps = np.diag([0.15, 0.15, 0.05]) ** 2, 0.12, [StochasticMap(MapSpec(unconfirmed_age=None))]
    for group, pose in zip(groups, (np.zeros(3), base)):
        seen = np.array([relative(pose, np.array([*landmark, 0.0]))[:2] for landmark in landmarks[group]])
        scan = Scan.from_points(seen + sigma * rng.standard_normal(seen.shape), sigma=sigma)
        maps[-1].add(scan, np.arange(len(group)))
        maps.append(maps[-1].successor())
    maps[0].predict(Odometry(base + np.sqrt(np.diag(Q)) * rng.standard_normal(3), Q))
    pairs = np.column_stack([np.arange(shared), shared + own + np.arange(shared)])
    return join(maps[0], maps[1]), pairs


def test_features_in_common_are_found_under_a_poor_relation_and_jointly_compatible() -> None:
    rng, right, wrong = np.random.default_rng(1), 0, 0
    for _ in range(40):
        m, true = two_maps(rng, 6, 2)
        found = jointly_compatible(m, np.arange(8), np.arange(8, 16))
        assert len(np.unique(found[:, 0])) == len(np.unique(found[:, 1])) == len(found)
        assert parts(m, found)[0] < gate(2 * len(found), 0.99)
        hits = len(set(map(tuple, found.tolist())) & set(map(tuple, true.tolist())))
        right, wrong = right + hits, wrong + len(found) - hits
    assert right > 0.9 * 240 and wrong < 0.15 * right


def test_sizes_and_kinds_tell_features_apart() -> None:
    m, exact = StochasticMap(), np.tile(0.01 * np.eye(2), (4, 1, 1))
    points = np.array([[1.0, 0.0], [3.0, 0.0], [1.02, 0.0], [3.01, 0.0]])
    sizes, variances = np.array([0.2, 0.5, 0.9, 0.5]), np.full(4, 1e-3)
    m.add(Scan(points, exact, sizes, variances, np.array([0, 1, 0, 1])), np.arange(4))
    np.testing.assert_array_equal(jointly_compatible(m, np.arange(2), np.arange(2, 4)), [[1, 3]])
    m = StochasticMap()
    m.add(Scan(points, exact, np.full(4, np.nan), np.full(4, np.nan), np.array([0, 1, 0, 2])), np.arange(4))
    np.testing.assert_array_equal(jointly_compatible(m, np.arange(2), np.arange(2, 4)), [[0, 2]])
