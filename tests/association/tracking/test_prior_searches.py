"""Global nearest neighbour, 1-point RANSAC and IPJC against brute force, with and without locality; bad input."""

import dataclasses
import functools
import itertools
import math

import numpy as np
import pytest
from scipy.optimize import least_squares

from slam_gym.association import ASSOCIATORS, global_nearest_neighbour, ipjc, jcbb, map_hypothesis, one_point_ransac
from slam_gym.types import UNPAIRED, Prediction, Scan
from tests.oracles import association as oracles

SEARCHES = [global_nearest_neighbour, one_point_ransac, ipjc, map_hypothesis]
J = np.array([[0.0, -1.0], [1.0, 0.0]])


def small_problem(seed, **options):
    rng = np.random.default_rng(seed)
    spread = float(rng.choice([1.0, 1.5, 2.0]))
    m, n = int(rng.integers(0, 6)), int(rng.integers(0, 7))
    return *oracles.problem(rng, m, n, spread=spread, confidence=0.95, **options), 0.95


def as_features(prediction, rows):
    return [UNPAIRED if row == UNPAIRED else int(prediction.features[row]) for row in rows]


def check(answer, scan, prediction, rows):
    assert answer.features.tolist() == as_features(prediction, rows)
    pairs = [(i, row) for i, row in enumerate(rows) if row != UNPAIRED]
    assert answer.joint_distance == pytest.approx(oracles.distance(scan, prediction, pairs), rel=1e-7, abs=1e-9)
    assert answer.dof == 2 * len(pairs)


def near_first(prediction, m, search):
    """`search(allowed rows, given row per measurement, relation or None)` once, or near first and then elsewhere."""
    n = len(prediction)
    if prediction.local is None:
        return search(np.ones(n, bool), [UNPAIRED] * m, None)
    near = prediction.near
    first = search(near, [UNPAIRED] * m, None)
    related = prediction.local(np.arange(n))
    return search(~near, first, related) if UNPAIRED in first else first


# global nearest neighbour


def cheapest(scan, prediction, confidence, allowed, given, _):
    """Every way to pair what is compatible, by its price."""
    lists = oracles.compatible(scan, prediction, confidence)
    undecided = [i for i in range(len(scan)) if given[i] == UNPAIRED]
    options, price = [], {}
    for i in undecided:
        found = [(d2, j) for d2, j in lists[i] if allowed[j] and j not in given]
        sizes = [np.log(np.linalg.det(prediction.covariances[j] + scan.covariances[i])) for _, j in found]
        price |= {(i, j): d2 + size for (d2, j), size in zip(found, sizes)}
        price[i, UNPAIRED] = oracles.gate(2, confidence) + max(sizes, default=0.0)
        options.append([UNPAIRED, *(j for _, j in found)])
    best, best_price = given, math.inf
    for choice in itertools.product(*options):
        paired = [j for j in choice if j != UNPAIRED]
        total = sum(price[i, j] for i, j in zip(undecided, choice))
        if len(set(paired)) == len(paired) and total < best_price:
            rows = list(given)
            for i, j in zip(undecided, choice):
                rows[i] = j
            best, best_price = rows, total
    return best


@pytest.mark.parametrize("seed", range(200))
def test_global_nearest_neighbour_is_the_cheapest_of_all_assignments(seed):
    scan, prediction, confidence = small_problem(seed, locality=seed % 2 == 0)
    rows = near_first(prediction, len(scan), functools.partial(cheapest, scan, prediction, confidence))
    check(global_nearest_neighbour(scan, prediction), scan, prediction, rows)


# 1-point RANSAC


def conditioned(scan, prediction, pairs, candidate):
    """D² of a candidate after an EKF update with `pairs`, by the formula."""
    rows = np.array([j for _, j in [*pairs, candidate]])
    S, d = prediction.joint(rows).copy(), 2 * len(pairs)
    for k, (i, _) in enumerate([*pairs, candidate]):
        S[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += scan.covariances[i]
    nu = np.concatenate([scan.points[i] - prediction.positions[j] for i, j in [*pairs, candidate]])
    gain = S[d:, :d] @ np.linalg.inv(S[:d, :d]) if d else np.zeros((2, 0))
    e, left = nu[d:] - gain @ nu[:d], S[d:, d:] - gain @ S[:d, d:]
    return float(e @ np.linalg.solve(left, e))


def nearest_first(distances, gate, taken):
    """Pairings within the gate by ascending distance, each measurement and feature once."""
    measured, features, out = {i for i, _ in taken}, {j for _, j in taken}, []
    for d2, (i, j) in sorted((d2, pair) for pair, d2 in distances.items()):
        if d2 < gate and i not in measured and j not in features:
            measured.add(i), features.add(j)
            out.append((d2, (i, j)))
    return out


def one_point(scan, prediction, confidence, allowed, given, related):
    """All anchors tried."""
    gate = oracles.gate(2, confidence)
    base = [(i, j) for i, j in enumerate(given) if j != UNPAIRED]
    lists = oracles.compatible(scan, prediction, confidence)
    candidates = [(i, j) for i, found in enumerate(lists) for _, j in found if given[i] == UNPAIRED and allowed[j]]

    def others(anchor):
        return [c for c in candidates if related is None or related[anchor[1], c[1]]]

    best = (0, 0.0, [])
    for a in candidates:
        distances = {
            c: conditioned(scan, prediction, [*base, a], c) for c in others(a) if c[0] != a[0] and c[1] != a[1]
        }
        found = [(conditioned(scan, prediction, base, a), a), *nearest_first(distances, gate, [a])]
        best = min(best, (-len(found), sum(d2 for d2, _ in found), [pair for _, pair in found]))
    pairs = best[2]
    rows = list(given)
    if pairs:
        left = {c: conditioned(scan, prediction, [*base, *pairs], c) for c in others(pairs[0]) if c not in pairs}
        left = {c: d2 for c, d2 in left.items() if c[0] not in dict(pairs) and c[1] not in [j for _, j in pairs]}
        pairs = [*pairs, *(pair for _, pair in nearest_first(left, gate, pairs))]
    for i, j in pairs:
        rows[i] = j
    return rows


@pytest.mark.parametrize("seed", range(200))
def test_one_point_ransac_finds_the_best_anchor_when_all_are_drawn(seed):
    scan, prediction, confidence = small_problem(1000 + seed, locality=seed % 2 == 0)
    rows = near_first(prediction, len(scan), functools.partial(one_point, scan, prediction, confidence))
    for shuffle in range(3):
        answer = one_point_ransac(scan, prediction, success=1.0 - 1e-15, seed=shuffle)
        check(answer, scan, prediction, rows)


def test_one_point_ransac_stops_early_and_says_when_it_was_stopped():
    scan, prediction = oracles.problem(np.random.default_rng(5), 12, 14, spread=2.0, spurious=0.1)
    everything = one_point_ransac(scan, prediction, success=1.0 - 1e-15)
    early = one_point_ransac(scan, prediction)
    assert early.effort.tries < everything.effort.tries
    assert early.dof == everything.dof
    stopped = one_point_ransac(scan, prediction, tries=2)
    assert stopped.effort.tries == 2 and stopped.effort.limit_hit and not early.effort.limit_hit


# IPJC


def turning_problem(rng, m, n, heading_sigma, spread=3.0):
    """A robot of uncertain heading, correlated with its map; the scan is taken from a pose drawn, by the true h."""
    features = rng.uniform(-spread, spread, (n, 2))
    mixing = np.zeros((3 + 2 * n, 3 + 2 * n))
    mixing[:3, :3] = np.diag([0.2, 0.2, heading_sigma])
    mixing[3:] = 0.03 * rng.standard_normal((2 * n, 3 + 2 * n))
    P = mixing @ mixing.T + 1e-6 * np.eye(3 + 2 * n)
    H = np.zeros((2 * n, 3 + 2 * n))
    for j, p in enumerate(features):
        H[2 * j : 2 * j + 2, :2], H[2 * j : 2 * j + 2, 2] = -np.eye(2), -J @ p
        H[2 * j : 2 * j + 2, 3 + 2 * j : 5 + 2 * j] = np.eye(2)
    S, across = H @ P @ H.T, (H @ P[:, 2]).reshape(n, 2)
    state = np.concatenate([np.zeros(3), features.ravel()])
    drawn = state + np.linalg.cholesky(P) @ rng.standard_normal(len(P))
    sigma, points, truth = 0.05, rng.uniform(-spread, spread, (m, 2)), np.full(m, UNPAIRED)
    for i, j in zip(range(round(0.7 * min(m, n))), rng.permutation(n)):
        points[i], truth[i] = look(drawn[:3], drawn[3:].reshape(-1, 2)[j]) + sigma * rng.standard_normal(2), j
    order = rng.permutation(m)
    prediction = dataclasses.replace(
        Prediction.from_gaussian(features, S), heading_variance=float(P[2, 2]), heading_covariances=across
    )
    scan = Scan.from_points(points[order], sigma=sigma)
    return scan, prediction, state, P, truth[order]


def look(pose, feature):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([[c, s], [-s, c]]) @ (feature - pose[:2])


def posterior_distance(scan, state, P, pairs):
    """Least cost of prior and measurements over the whole state, nonlinear, by scipy."""
    L = np.linalg.cholesky(P)

    def residuals(whitened):
        x = state + L @ whitened
        seen = [
            (scan.points[i] - look(x[:3], x[3 + 2 * j : 5 + 2 * j])) / math.sqrt(scan.covariances[i, 0, 0])
            for i, j in pairs
        ]
        return np.concatenate([whitened, *seen])

    return 2.0 * float(least_squares(residuals, np.zeros(len(P)), xtol=1e-12, ftol=1e-12, gtol=1e-12).cost)


@pytest.mark.parametrize("seed", range(40))
def test_ipjc_is_the_best_path_by_the_nonlinear_optimum(seed):
    rng = np.random.default_rng(seed)
    scan, prediction, state, P, _ = turning_problem(
        rng, int(rng.integers(1, 5)), int(rng.integers(1, 5)), 0.3, spread=1.5
    )

    @functools.cache
    def distance(pairs):
        return posterior_distance(scan, state, P, pairs) if pairs else 0.0

    lists, best = oracles.compatible(scan, prediction, 0.99), (0, 0.0, ())
    paths = [((), 0)]
    while paths:
        pairs, level = paths.pop()
        best = min(best, (-len(pairs), distance(pairs), pairs))
        if level == len(scan):
            continue
        paths.append((pairs, level + 1))
        for _, j in lists[level]:
            longer = (*pairs, (level, j))
            if j not in dict(pairs).values() and distance(longer) < oracles.gate(2 * len(longer), 0.99):
                paths.append((longer, level + 1))
    rows = dict(best[2])
    answer = ipjc(scan, prediction)
    assert answer.features.tolist() == [rows.get(i, UNPAIRED) for i in range(len(scan))]
    assert answer.joint_distance == pytest.approx(best[1], rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("seed", range(150))
def test_ipjc_is_jcbb_where_nothing_turns(seed):
    scan, prediction, _ = small_problem(seed, locality=seed % 2 == 0)
    expected = jcbb(scan, prediction)
    for variance, close in ((0.0, 1e-8), (1e-12, 1e-4)):
        answer = ipjc(scan, dataclasses.replace(prediction, heading_variance=variance))
        assert answer.features.tolist() == expected.features.tolist()
        assert answer.joint_distance == pytest.approx(expected.joint_distance, rel=close, abs=close)


@pytest.mark.parametrize("seed", range(40))
def test_ipjc_tends_to_jcbb_as_the_heading_becomes_certain(seed):
    scan, prediction, *_ = turning_problem(np.random.default_rng(seed), 6, 8, 1e-5)
    expected, answer = jcbb(scan, prediction), ipjc(scan, prediction)
    assert answer.features.tolist() == expected.features.tolist()
    assert answer.joint_distance == pytest.approx(expected.joint_distance, rel=1e-3, abs=1e-3)


def test_ipjc_misses_fewer_pairings_than_jcbb_when_the_heading_is_far_off():
    missed = {"jcbb": 0, "ipjc": 0}
    for seed in range(60):
        scan, prediction, _, _, truth = turning_problem(np.random.default_rng(seed), 10, 10, 0.25, spread=8.0)
        for name in missed:
            features = ASSOCIATORS[name](scan, prediction).features
            missed[name] += int(((features != truth) & (truth != UNPAIRED)).sum())
    assert 0 < missed["ipjc"] < 0.7 * missed["jcbb"], missed


def test_ipjc_reports_its_node_limit():
    scan, prediction = oracles.problem(np.random.default_rng(2), 12, 14, spread=1.0)
    free = ipjc(scan, prediction)
    stopped = ipjc(scan, prediction, node_limit=10)
    assert not free.effort.limit_hit and free.effort.nodes > 10
    assert stopped.effort.limit_hit and stopped.effort.nodes == 10


# bad input


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("where", ["points", "covariances"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_numbers_that_are_not_finite_are_named(search, where, value):
    scan, prediction = oracles.problem(np.random.default_rng(0), 4, 5)
    spoilt = getattr(scan, where).copy()
    spoilt[(2,) + (0,) * (spoilt.ndim - 1)] = value
    with pytest.raises(ValueError, match=rf"scan.{where}\[2\]"):
        search(dataclasses.replace(scan, **{where: spoilt}), prediction)


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("matrix", [-np.eye(2), [[1.0, 2.0], [2.0, 1.0]]])
def test_covariances_that_are_none_are_named(search, matrix):
    scan, prediction = oracles.problem(np.random.default_rng(0), 4, 5)
    noise = scan.covariances.copy()
    noise[1] = matrix
    with pytest.raises(ValueError, match=r"scan.covariances\[1\]"):
        search(dataclasses.replace(scan, covariances=noise), prediction)


@pytest.mark.parametrize("search", SEARCHES)
def test_a_singular_innovation_covariance_is_named(search):
    scan, prediction = oracles.problem(np.random.default_rng(0), 4, 5)
    certain = dataclasses.replace(
        prediction,
        positions=np.tile(scan.points[:1], (5, 1)),
        covariances=np.tile([[1.0, 1.0], [1.0, 1.0]], (5, 1, 1)),
    )
    with pytest.raises(ValueError, match="singular"):
        search(dataclasses.replace(scan, covariances=np.zeros((4, 2, 2))), certain)


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize(("m", "n"), [(1, 1), (1, 8), (12, 2), (9, 1)])
@pytest.mark.parametrize("seed", range(5))
def test_one_measurement_and_more_measurements_than_features(search, m, n, seed):
    scan, prediction = oracles.problem(np.random.default_rng(seed), m, n, spread=1.0)
    answer = search(scan, prediction)
    paired = answer.features[answer.features != UNPAIRED]
    assert len(set(paired.tolist())) == len(paired) and set(paired.tolist()) <= set(prediction.features.tolist())


@pytest.mark.parametrize("search", SEARCHES)
def test_all_spurious_pairs_nothing(search):
    scan, prediction = oracles.problem(np.random.default_rng(0), 6, 8)
    answer = search(dataclasses.replace(scan, points=scan.points + 100.0), prediction)
    assert answer.features.tolist() == [UNPAIRED] * 6 and (answer.joint_distance, answer.dof) == (0.0, 0)


@pytest.mark.parametrize("search", SEARCHES)
def test_duplicate_features_and_features_on_a_line_are_paired_once_each(search):
    rng = np.random.default_rng(1)
    line = np.column_stack([np.arange(6.0), np.zeros(6)])
    at = np.concatenate([line, line])  # every feature twice, at one place
    prediction = Prediction.from_gaussian(at, 0.01 * np.ones((24, 24)) + 1e-4 * np.eye(24))
    scan = Scan.from_points(line + 0.01 * rng.standard_normal((6, 2)), sigma=0.01)
    answer = search(scan, prediction)
    assert (answer.features % 6).tolist() == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("search", "options"),
    [
        (one_point_ransac, {"tries": 0}),
        (one_point_ransac, {"success": 1.0}),
        (ipjc, {"node_limit": 0}),
    ],
)
def test_meaningless_options_are_refused(search, options):
    scan, prediction = oracles.problem(np.random.default_rng(0), 3, 3)
    with pytest.raises(ValueError, match=next(iter(options))):
        search(scan, prediction, **options)
