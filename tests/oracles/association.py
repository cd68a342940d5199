"""Slow, direct definitions of every associator, and small random problems to hold the fast ones against.

Nothing here calls the package's own compatibility, tree or search.
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from scipy.stats import chi2

from slam_gym.association.prediction import Prediction
from slam_gym.types import UNPAIRED, Array, Hypothesis, Scan
from tests.oracles.geometry import block_diagonal, rigid_motions


def expecting(
    positions: Array,
    P: Array,
    *,
    features: Array | None = None,
    near: Array | None = None,
    related: Array | None = None,
    heading_variance: float = 0.0,
    across: Array | None = None,
    sightings: Array | None = None,
    confirmations: int = 0,
    confidence: float = 0.99,
) -> Prediction:
    """A prediction of k positions (k, 2) with joint covariance (2k, 2k), and what else may be known of its rows."""
    k = len(positions)
    plain = Prediction.from_gaussian(positions, P, confidence=confidence)
    features = np.arange(k) if features is None else features
    n = int(features.max(initial=-1)) + 1
    x, whole = np.zeros(3 + 2 * n), np.zeros((3 + 2 * n, 3 + 2 * n))
    entries = np.array([3 + 2 * j + a for j in features for a in range(2)], np.int64)
    x[entries], whole[np.ix_(entries, entries)] = positions.ravel(), P
    known = plain.expected._replace(features=features, state=x, covariance=whole, n=n, view_moves=True)
    known = known._replace(pose=np.array([0.0, 0.0, 0.0, heading_variance]))
    if related is not None:
        counts = np.zeros((max(n, 1), max(n, 1)), np.int32)
        counts[np.ix_(features, features)] = related
        known = known._replace(counts=counts)
    given = {"near": near, "across": across, "sightings": sightings}
    known = known._replace(**{name: array for name, array in given.items() if array is not None})
    return dataclasses.replace(plain, expected=known, confirmations=confirmations)


def turning_by(prediction: Prediction, variance: float) -> Prediction:
    """The same for a heading of that variance [rad²], which is not correlated with anything."""
    turned = prediction.expected._replace(pose=np.array([0.0, 0.0, 0.0, variance]))
    return dataclasses.replace(prediction, expected=turned)


def related_by(prediction: Prediction, related: Array) -> Prediction:
    """The same with localities (k, k)."""
    k, joint = len(prediction), prediction.joint(np.arange(len(prediction))) if len(prediction) else np.empty((0, 0))
    return expecting(
        prediction.positions.reshape(k, 2),
        joint,
        features=np.array(prediction.features),
        near=np.array(prediction.near),
        related=related,
        confidence=prediction.confidence,
    )


def without_locality(prediction: Prediction) -> Prediction:
    """The same, with all features local to all."""
    all_near, all_local = np.ones(len(prediction), np.bool_), np.empty((0, 0), np.int32)
    return dataclasses.replace(prediction, expected=prediction.expected._replace(near=all_near, counts=all_local))


def problem(
    rng: np.random.Generator,
    m: int,
    n: int,
    *,
    spread: float = 3.0,
    heading_sigma: float = 0.15,
    spurious: float = 0.3,
    noise: float = 0.05,
    locality: bool = False,
    confidence: float = 0.99,
) -> tuple[Scan, Prediction]:
    """A scan of m measurements before a map of n correlated features within ±`spread` m, ambiguous on purpose.

    The joint covariance is that of a robot of uncertain pose (common to all features: strong correlations) over a map
    of independent small errors. With locality, features fall into three groups, one of them near.
    """
    positions = rng.uniform(-spread, spread, (n, 2))
    jacobian = -rigid_motions(positions)
    pose = np.diag([0.3, 0.3, heading_sigma]) ** 2
    mixing = 0.05 * rng.standard_normal((2 * n, 2 * n))
    P = jacobian @ pose @ jacobian.T + mixing @ mixing.T / max(n, 1) + 1e-3 * np.eye(2 * n)
    R = np.array([random_covariance(rng, noise) for _ in range(m)]).reshape(m, 2, 2)
    drawn = positions.ravel() + (np.linalg.cholesky(P) @ rng.standard_normal(2 * n) if n else 0.0)
    points = rng.uniform(-spread, spread, (m, 2))
    real = rng.permutation(min(m, n))[: round((1.0 - spurious) * min(m, n))]
    for i, j in zip(real, rng.permutation(n)):
        points[i] = drawn.reshape(-1, 2)[j] + np.linalg.cholesky(R[i]) @ rng.standard_normal(2)
    features = np.sort(rng.permutation(3 * n)[:n])
    near = related = None
    if locality:
        group, stray = rng.integers(0, 3, n), rng.random((n, n)) < 0.1
        related = (group[:, None] == group) | stray | stray.T
        near = (group == 0) & (rng.random(n) < 0.9)
    prediction = expecting(positions, P, features=features, near=near, related=related, confidence=confidence)
    return Scan.from_points(points, R), prediction


def random_covariance(rng: np.random.Generator, sigma: float) -> Array:
    a = rng.standard_normal((2, 2))
    return sigma**2 * (a @ a.T + 0.5 * np.eye(2))


@functools.cache
def gate(dof: int, confidence: float) -> float:
    """χ²_{dof,conf}."""
    return float(chi2.ppf(confidence, dof))


def distance(scan: Scan, prediction: Prediction, pairs: list[tuple[int, int]]) -> float:
    """D²_H of pairings (measurement, row), by the formula."""
    if not pairs:
        return 0.0
    nu, S = stacked(scan, prediction, pairs)
    return float(nu @ np.linalg.solve(S, nu))


def stacked(scan: Scan, prediction: Prediction, pairs: list[tuple[int, int]]) -> tuple[Array, Array]:
    """ν and S of pairings (measurement, row)."""
    measured, rows = np.array(pairs).T
    S = prediction.joint(rows) + block_diagonal(scan.covariances[measured])
    return (scan.points[measured] - prediction.positions[rows]).ravel(), S


def decisions(pairs: list[tuple[int, int]], m: int) -> list[int]:
    """Partner of each of m measurements, or UNPAIRED."""
    partners = [UNPAIRED] * m
    for i, j in pairs:
        partners[i] = int(j)
    return partners


def compatible(scan: Scan, prediction: Prediction, confidence: float) -> list[list[tuple[float, int]]]:
    """Per measurement its individually compatible (D², row), ascending."""
    lists = []
    for i in range(len(scan)):
        found = []
        for j in range(len(prediction)):
            nu = scan.points[i] - prediction.positions[j]
            d2 = float(nu @ np.linalg.solve(prediction.covariances[j] + scan.covariances[i], nu))
            if d2 < gate(2, confidence):
                found.append((d2, j))
        lists.append(sorted(found))
    return lists


def nearest(scan: Scan, prediction: Prediction, confidence: float) -> list[int]:
    """Row per measurement: the compatible one of least D²."""
    return [found[0][1] if found else UNPAIRED for found in compatible(scan, prediction, confidence)]


def singles(scan: Scan, prediction: Prediction, confidence: float) -> list[int]:
    """Row per measurement: where each is the other's only compatible one."""
    lists = compatible(scan, prediction, confidence)
    everywhere = [j for found in lists for _, j in found]
    return [found[0][1] if len(found) == 1 and everywhere.count(found[0][1]) == 1 else UNPAIRED for found in lists]


def best_path(
    scan: Scan,
    prediction: Prediction,
    confidence: float,
    *,
    allowed: np.ndarray | None = None,
    given: list[int] | None = None,
    related: np.ndarray | None = None,
) -> tuple[list[int], float]:
    """Most pairings, then least D²_H, over *every* path all prefixes of which are jointly compatible. No bound.

    allowed (n,) rows that may be paired; given: row per measurement decided before, UNPAIRED for those to decide;
    related (n, n): pairings must be related to the first one made here.
    """
    n = len(prediction)
    allowed = np.ones(n, bool) if allowed is None else allowed
    given = [UNPAIRED] * len(scan) if given is None else given
    lists = compatible(scan, prediction, confidence)
    base = [(i, j) for i, j in enumerate(given) if j != UNPAIRED]
    undecided = [i for i, j in enumerate(given) if j == UNPAIRED]
    best: tuple[int, float, list[tuple[int, int]]] = (len(base), distance(scan, prediction, base), base)
    stack = [(0, base)]
    while stack:
        level, pairs = stack.pop()
        if level == len(undecided):
            d2 = distance(scan, prediction, pairs)
            if len(pairs) > best[0] or (len(pairs) == best[0] and d2 < best[1]):
                best = (len(pairs), d2, pairs)
            continue
        stack.append((level + 1, pairs))
        used = {j for _, j in pairs}
        for _, j in lists[undecided[level]]:
            if not allowed[j] or j in used:
                continue
            if related is not None and len(pairs) > len(base) and not related[pairs[len(base)][1], j]:
                continue
            longer = [*pairs, (undecided[level], j)]
            if distance(scan, prediction, longer) < gate(2 * len(longer), confidence):
                stack.append((level + 1, longer))
    return decisions(best[2], len(scan)), best[1]


def jcbb(scan: Scan, prediction: Prediction, confidence: float) -> tuple[list[int], float]:
    """JCBB as the best of all paths; with locality in the two searches it is defined by."""
    if not prediction.has_localities:
        return best_path(scan, prediction, confidence)
    near = prediction.near
    first, _ = best_path(scan, prediction, confidence, allowed=near)
    related = prediction.local(np.arange(len(prediction)))
    return best_path(scan, prediction, confidence, allowed=~near, given=first, related=related)


def greedy(scan: Scan, prediction: Prediction, confidence: float) -> list[int]:
    """The first legal branch at every level: the nearest unused feature that keeps the hypothesis compatible."""
    pairs: list[tuple[int, int]] = []
    for i, found in enumerate(compatible(scan, prediction, confidence)):
        for _, j in found:
            longer = [*pairs, (i, j)]
            legal = distance(scan, prediction, longer) < gate(2 * len(longer), confidence)
            if legal and all(j != used for _, used in pairs):
                pairs = longer
                break
    return decisions(pairs, len(scan))


def small_problem(seed: int, **options: bool) -> tuple[Scan, Prediction, float]:
    """A problem that brute force can still enumerate, and its confidence."""
    rng, confidence = np.random.default_rng(seed), (0.9, 0.95, 0.99)[seed % 3]
    spread = float(rng.choice([1.0, 1.5, 2.0, 3.0]))
    m, n = int(rng.integers(0, 7)), int(rng.integers(0, 9))
    return *problem(rng, m, n, spread=spread, confidence=confidence, **options), confidence


def smaller_problem(seed: int, **options: bool) -> tuple[Scan, Prediction, float]:
    """The same for what takes longer to enumerate."""
    rng = np.random.default_rng(seed)
    spread = float(rng.choice([1.0, 1.5, 2.0]))
    m, n = int(rng.integers(0, 6)), int(rng.integers(0, 7))
    return *problem(rng, m, n, spread=spread, confidence=0.95, **options), 0.95


def as_features(prediction: Prediction, rows: list[int]) -> list[int]:
    return [UNPAIRED if row == UNPAIRED else int(prediction.features[row]) for row in rows]


def check(answer: Hypothesis, scan: Scan, prediction: Prediction, rows: list[int]) -> None:
    """`answer` pairs these rows, and its distance is theirs."""
    assert answer.features.tolist() == as_features(prediction, rows)
    pairs = [(i, row) for i, row in enumerate(rows) if row != UNPAIRED]
    assert np.isclose(answer.joint_distance, distance(scan, prediction, pairs), rtol=1e-7, atol=1e-9)
    assert answer.dof == 2 * len(pairs)


def near_first(prediction: Prediction, m: int, search: Callable[..., list[int]]) -> list[int]:
    """`search(allowed rows, given row per measurement, relation or None)` once, or near first and then elsewhere."""
    n = len(prediction)
    if not prediction.has_localities:
        return search(np.ones(n, bool), [UNPAIRED] * m, None)
    first = search(prediction.near, [UNPAIRED] * m, None)
    return search(~prediction.near, first, prediction.local(np.arange(n))) if UNPAIRED in first else first


def conditioned(scan: Scan, prediction: Prediction, pairs: list[tuple[int, int]], candidate: tuple[int, int]) -> float:
    """D² of a candidate after an EKF update with `pairs`, by the formula."""
    (nu, S), d = stacked(scan, prediction, [*pairs, candidate]), 2 * len(pairs)
    gain = S[d:, :d] @ np.linalg.inv(S[:d, :d]) if d else np.zeros((2, 0))
    e, left = nu[d:] - gain @ nu[:d], S[d:, d:] - gain @ S[:d, d:]
    return float(e @ np.linalg.solve(left, e))
