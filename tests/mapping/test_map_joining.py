"""Map joining against finite differences, the null-space form of a constraint, and one EKF over everything."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.geometry import compose, transform, wrap_angle
from slam_gym.mapping import ekf
from slam_gym.mapping.map_joining import (
    directions_turned,
    equality_update,
    equate,
    join,
    join_all,
    joined_estimate,
)
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.metrics.consistency import nees
from slam_gym.types import UNKNOWN_KIND, Array, Odometry, Scan
from tests.mapping.small_maps import smallest_over_largest
from tests.oracles.geometry import differences, numerical
from tests.oracles.map import KnownAssociation, Step, make_scan, random_covariances, wander
from tests.oracles.statistics import anees_interval, for_seeds

KEEP = MapSpec(unconfirmed_age=None)


def random_estimate(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """x (3 + 2n,) and P of a map: anything."""
    d = 3 + 2 * n
    mean = rng.uniform(-5, 5, d)
    mean[2] = rng.uniform(-math.pi, math.pi)
    factor = 0.3 * rng.standard_normal((d, d))
    return mean, factor @ factor.T


def joined_by_geometry(x_a: Array, x_b: Array) -> Array:
    """The joined state, by the composition of poses and points."""
    robot = compose(x_a[:3], x_b[:3])
    features = transform(x_a[:3].copy(), np.ascontiguousarray(x_b[3:].reshape(-1, 2)))
    return np.concatenate([robot, x_a[3:], features.ravel()])


@for_seeds(20)
def test_joined_estimate_is_first_order_propagation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    (x_a, P_a), (x_b, P_b) = random_estimate(rng, seed % 4), random_estimate(rng, seed % 5)
    mean, P = joined_estimate(x_a, P_a, x_b, P_b)
    np.testing.assert_allclose(mean, joined_by_geometry(x_a, x_b), rtol=0, atol=1e-12)
    J = numerical(lambda x: joined_by_geometry(x[: len(x_a)], x[len(x_a) :]), np.concatenate([x_a, x_b]), wrapped=2)
    zero = np.zeros((len(x_a), len(x_b)))
    expected = J @ np.block([[P_a, zero], [zero.T, P_b]]) @ J.T
    np.testing.assert_allclose(P, expected, rtol=0, atol=1e-7)
    assert np.array_equal(P, P.T)


@for_seeds(20)
def test_equality_update_is_the_estimate_on_the_subspace_of_equal_features(seed: int) -> None:
    """With x = N y, N a basis of {F_a = F_b}: y = (Nᵀ P⁻¹ N)⁻¹ Nᵀ P⁻¹ x, generalised least squares."""
    rng = np.random.default_rng(50 + seed)
    n = 8
    mean, P = random_estimate(rng, n)
    mean[2] = 0.3
    P += 0.01 * np.eye(len(P))
    chosen = rng.permutation(n)
    pairs = chosen[: 2 * (1 + seed % 4)].reshape(-1, 2)
    constraint = np.pad(differences(pairs, n), ((0, 0), (3, 0)))
    N = np.linalg.svd(constraint)[2][len(constraint) :].T
    information = np.linalg.inv(P)
    expected = N @ np.linalg.inv(N.T @ information @ N) @ N.T
    x, after = equality_update(mean, P, pairs, invariant=False)
    estimate = expected @ information @ mean
    estimate[2] = wrap_angle(estimate[2])
    np.testing.assert_allclose(x, estimate, rtol=0, atol=1e-8)
    np.testing.assert_allclose(after, expected, rtol=0, atol=1e-8)
    np.testing.assert_allclose(x[3 + 2 * pairs[:, 0]], x[3 + 2 * pairs[:, 1]], atol=1e-9)


# --- against one EKF over everything ----------------------------------------------------------------------------------


def local_maps(steps: list[Step], at: list[int]) -> Iterator[KnownAssociation]:
    """A map of the steps between each two of the cuts `at`, each the successor of the one before."""
    previous = StochasticMap(KEEP)
    for first, last in zip([0, *at], [*at, len(steps)]):
        local = KnownAssociation(previous.successor())
        for step in steps[first:last]:
            local.step(step)
        yield local
        previous = local.map


def halves(steps: list[Step], at: list[int]) -> tuple[StochasticMap, list[int]]:
    """Local maps of the steps between the cuts `at`, joined under known association; landmark behind each feature."""
    whole, sources = None, []
    for local in local_maps(steps, at):
        if whole is None:
            whole, sources = local.map, list(local.sources)
        else:
            count, older = whole.n, {source: j for j, source in enumerate(sources)}
            pairs = [(older[s], count + j) for j, s in enumerate(local.sources) if s in older]
            whole = equate(join(whole, local.map), np.array(pairs))
            sources += [s for s in local.sources if s not in older]
    assert whole is not None
    return whole, sources


def by_source(m: StochasticMap, sources: list[int]) -> tuple[Array, Array]:
    """x and P with the features in the order of their landmarks."""
    order = np.argsort(sources)
    entries = np.concatenate([np.arange(3), (3 + 2 * order[:, None] + np.arange(2)).ravel()])
    return m.mean[entries], m.covariance[np.ix_(entries, entries)]


@pytest.mark.parametrize("at", [[15], [10, 20], [7, 14, 21, 28]])
def test_equals_one_ekf_where_the_heading_is_known(at: list[int]) -> None:
    """Without heading noise everything is linear: the order in which independent information comes in is immaterial."""
    rng = np.random.default_rng(11)
    landmarks = rng.uniform([-4.0, -2.0], [5.0, 7.0], (30, 2))
    q = np.diag([0.05, 0.03, 0.0]) ** 2
    steps = list(wander(rng, 36, landmarks, reach=4.0, q=q))
    one = KnownAssociation(StochasticMap(KEEP))
    for step in steps:
        one.step(step)
    joined, sources = halves(steps, at)
    assert sorted(sources) == sorted(one.sources) and len(sources) > 15
    for ours, theirs in zip(by_source(joined, sources), by_source(one.map, one.sources)):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 1e-5), (0.01, 0.02)])
def test_all_at_once_is_what_one_after_the_other_gives(noise: float, tolerance: float) -> None:
    """Where the heading is known both are exact; else they differ by where they linearise, here by 2 cm at most."""
    rng = np.random.default_rng(11)
    landmarks = rng.uniform([-4.0, -2.0], [5.0, 7.0], (30, 2))
    q = np.diag([0.05, 0.03, max(noise, 1e-6)]) ** 2
    steps, at = list(wander(rng, 36, landmarks, reach=4.0, q=q)), [10, 20]
    one_by_one, sources = halves(steps, at)
    maps, names = zip(*((local.map, np.array(local.sources)) for local in local_maps(steps, at)))
    best = join_all(maps, names)
    np.testing.assert_array_equal(best.ids, np.sort(sources))
    expected, P = by_source(one_by_one, sources)
    np.testing.assert_allclose(np.concatenate([best.poses[-1], best.positions.ravel()]), expected, atol=tolerance)
    np.testing.assert_allclose(best.covariance([len(maps)], best.ids), P, atol=tolerance * np.abs(P).max() ** 0.5)


def test_maps_that_share_nothing_are_only_placed() -> None:
    """χ² is zero from the start: nothing contradicts anything, not even for one map alone or an empty one."""
    a, b = two_small_maps()
    both = join(a, b)
    best = join_all([a, b], [a.ids, b.ids])
    np.testing.assert_allclose(best.positions, both.positions, atol=1e-9)
    np.testing.assert_allclose(best.poses, [np.zeros(3), a.pose, compose(a.pose, b.pose)], atol=1e-9)
    np.testing.assert_allclose(best.covariance([2], best.ids), both.covariance, atol=1e-9)
    np.testing.assert_allclose(join_all([a], [a.ids]).positions, a.positions, atol=1e-9)
    empty = join_all([a, a.successor()], [a.ids, np.empty(0, np.int64)])
    np.testing.assert_allclose(empty.poses[1:], [a.pose, a.pose], atol=1e-9)


def test_joined_maps_are_consistent() -> None:
    """NEES of the whole state (robot and all features) over many runs of a drifting robot, three maps each."""
    values, dofs = [], 0
    for seed in range(60):
        rng = np.random.default_rng(1000 + seed)
        landmarks = rng.uniform([-4.0, -2.0], [5.0, 7.0], (20, 2))
        steps = list(wander(rng, 45, landmarks))
        joined, sources = halves(steps, [15, 30])
        x, P = by_source(joined, sources)
        error = x - np.concatenate([steps[-1].pose, landmarks[np.sort(sources)].ravel()])
        error[2] = wrap_angle(error[2])
        values.append(nees(error, P))
        dofs += len(x)
    low, high = anees_interval(1, dofs, 0.999)
    assert low < sum(values) / dofs < high


# --- bookkeeping ------------------------------------------------------------------------------------------------------


def sized(points: list[list[float]], sizes: list[float], variances: list[float], kinds: list[int]) -> Scan:
    scan = make_scan(np.array(points), np.tile(0.01 * np.eye(2), (len(points), 1, 1)))
    return Scan(scan.points, scan.covariances, np.array(sizes), np.array(variances), np.array(kinds))


def two_small_maps() -> tuple[StochasticMap, StochasticMap]:
    """Three features each; the robot of the first stands 1 m ahead of its base."""
    a = StochasticMap(KEEP)
    a.add(sized([[2, 0], [2, 1], [2, 2]], [0.5, np.nan, 0.3], [0.01, np.nan, 0.02], [3, UNKNOWN_KIND, 2]), np.arange(3))
    a.end_of_step()
    a.predict(Odometry(np.array([1.0, 0.0, 0.0]), 1e-4 * np.eye(3)))
    b = a.successor()
    b.add(sized([[1, 0], [1, 1], [9, 9]], [0.7, 0.4, 0.6], [0.03, 0.05, 0.01], [3, 1, UNKNOWN_KIND]), np.arange(3))
    b.end_of_step()
    return a, b


def test_what_is_known_of_a_duplicate_goes_to_the_older_feature() -> None:
    a, b = two_small_maps()
    m = equate(join(a, b), np.array([[0, 3], [1, 4]]))
    np.testing.assert_array_equal(m.ids, [0, 1, 2, 5])
    np.testing.assert_array_equal(m.seen, [2, 2, 1, 1])
    np.testing.assert_array_equal(m.first_seen, [0, 0, 0, 1])
    np.testing.assert_array_equal(m.last_seen, [1, 1, 0, 1])
    np.testing.assert_allclose(m.sizes, [(0.5 / 0.01 + 0.7 / 0.03) / (1 / 0.01 + 1 / 0.03), 0.4, 0.3, 0.6])
    np.testing.assert_allclose(m.size_variances, [0.0075, 0.05, 0.02, 0.01])
    np.testing.assert_array_equal(m.kinds, [3, 1, 2, UNKNOWN_KIND])
    before, after = join(a, b).state.counted[ekf.DIRECTIONS], m.state.counted[ekf.DIRECTIONS]
    np.testing.assert_array_equal(after, [before[0] | before[3], before[1] | before[4], before[2], before[5]])
    np.testing.assert_allclose(m.positions, [[2, 0], [2, 1], [2, 2], [10, 9]], atol=1e-9)
    assert m.step == join(b, a).step == max(a.step, b.step) == 2
    m.add(sized([[1, 1]], [1.0], [1.0], [0]), np.array([0]))
    assert m.ids[-1] == 6  # given by nobody before


@pytest.mark.parametrize("sector", [0, 1, 30, 58, 59])
def test_directions_turn_by_whole_sectors(sector: int) -> None:
    for by in range(-120, 121):
        counted = np.full((6, 2), 7)
        counted[ekf.DIRECTIONS] = 1 << sector, 0
        turned = directions_turned(counted, math.radians(6.0 * by))
        counted[ekf.DIRECTIONS, 0] = 1 << (sector + by) % 60
        np.testing.assert_array_equal(turned, counted)


def test_the_maps_that_are_joined_stay_as_they_were() -> None:
    a, b = two_small_maps()
    before = a.mean, a.covariance, b.mean, b.covariance
    m = join(a, b)
    equate(m, np.array([[0, 3]]))
    for old, new in zip(before, (a.mean, a.covariance, b.mean, b.covariance)):
        np.testing.assert_array_equal(old, new)
    assert m.n == 6


@pytest.mark.parametrize("pairs", [[[0, 6]], [[-1, 2]], [[0, 3], [1, 3]], [[0, 1], [1, 2]], [[2, 2]]])
def test_pairs_that_make_no_sense_and_ids_given_twice_are_refused(pairs: list[list[int]]) -> None:
    a, b = two_small_maps()
    with pytest.raises(ValueError, match="pairs"):
        equate(join(a, b), np.array(pairs))
    with pytest.raises(ValueError, match="ids"):
        join(a, a)


def test_equality_is_consistent_where_the_heading_is_known_to_20_degrees() -> None:
    sigma, of_robot, count = 0.05, np.array([0.3, 0.3, 0.35]), 100
    invariant, linear = [], []
    for seed in range(count):
        rng = np.random.default_rng((90, seed))
        points, noise = rng.uniform(-8.0, 8.0, (10, 2)), np.tile(sigma**2 * np.eye(2), (10, 1, 1))
        m = StochasticMap(KEEP)
        m.add(make_scan(points + rng.normal(0.0, sigma, (10, 2)), noise), np.arange(10))
        m.predict(Odometry(of_robot * rng.standard_normal(3), np.diag(of_robot**2)))  # in truth the robot stands still
        m.add(make_scan(points[:6] + rng.normal(0.0, sigma, (6, 2)), noise[:6]), np.arange(6))
        true = np.concatenate([np.zeros(3), points.ravel(), points[3:6].ravel()])
        for spec, errors in ((KEEP, invariant), (replace(KEEP, right_invariant=False), linear)):
            fused = equate(StochasticMap.of_state(spec, m.state), np.array([[0, 10], [1, 11], [2, 12]]))
            errors.append(nees(fused.mean - true, fused.covariance))
    low, high = anees_interval(count, len(true), 0.999)
    assert low < np.mean(invariant) / len(true) < high
    assert np.mean(linear) / len(true) > 10.0


def test_equality_stays_psd_for_certainties_of_very_different_sizes() -> None:
    rng = np.random.default_rng(9)
    for _ in range(100):
        m = StochasticMap(KEEP)
        m.predict(Odometry(rng.normal(0, 1, 3), np.diag(10.0 ** rng.uniform(-6, 2, 3))))
        scale = 10.0 ** rng.uniform(-4, 0)
        covariances = random_covariances(rng, scale, 10)
        m.add(make_scan(rng.uniform(-5, 5, (10, 2)), covariances), np.arange(10))
        chosen = rng.permutation(10)[: 2 * int(rng.integers(1, 5))]
        assert smallest_over_largest(equate(m, chosen.reshape(-1, 2))) >= -1e-9
