"""Acceptance of hypotheses: the expected number of accidental matches of a scan with a map.

Let landmarks lie at random with density λ. A set of k measurements matches k of them by chance when, for some pose, the
errors satisfy D² < γ = χ²_{2k−3,conf}. The landmark positions for which this holds form a tube in R^{2k} around the
three-dimensional surface of all poses. Whitened by S = Σ of scan and map, its cross-section is a ball of 2k − 3
dimensions and radius √γ, volume V_{2k−3} γ^{(2k−3)/2}, and the surface element is √det(AᵀS⁻¹A) = 1/√det Σ_pose (see
`relocation.location`). Integrated over the area of the map, λ·area = n, and over all headings, the expected number is

    n · 2π λ^{k−1} · √(det S / det Σ_pose) · V_{2k−3} γ^{(2k−3)/2},

for k = 2 the familiar n · λ · 2πd · 2√γ σ of an annulus. With independent errors of a_i = √det(R_i + P) per pairing,
det S = Π a_i² and 1/√det Σ_pose = k √(Σ|z − z̄|²) / σ³. Summed over all k of the m measurements,

    E_k = 2π · Σ_j λ_j^{k−1} · e_k(a_1 q_1, …, a_m q_m) · k √((k − 1) s²) / σ³ · V_{2k−3} γ^{(2k−3)/2},

where e_k is the elementary symmetric polynomial, q_i the fraction of landmarks that pass the unary constraints of
measurement i, s² the variance of the scan's points, σ² the mean of a_i, and λ_j the density around landmark j within
the extent of a scan, so that crowded corners count as such. With c_j other landmarks in that area A, λ_j^{k−1} is
estimated by c_j (c_j − 1) … (c_j − k + 2) / A^{k−1}. For a Poisson process this is unbiased, which a power of c_j / A
is not; but c_j is counted by hashing, and is too large by about one: in sparse maps E_k is several times too large, on
the safe side. Where the sum of these is smaller than n λ̄^{k−1} with the mean density λ̄, the latter is used. All of it
is computed as logarithms: the number of hypotheses of a scan of some hundred measurements overflows a float.

Every further pairing multiplies E_k by about λ π γ σ². A hypothesis is accepted from the first k on for which fewer
than `probability` accidental hypotheses are expected.

Buildings are no Poisson process: corners and doors repeat along walls, and one pairing more than expected is found by
chance. So one more is required, unless the pairings explain most of the scan, which they do not in another building.
(To reject hypotheses no better than the best for the mirror image of the scan yields equally few wrong answers, but
costs a sixth of the right ones: many a room is its own mirror image.)

With a prior on the pose, the same rule applies to old features. The robot has not seen these lately, and so knows their
positions relative to itself less well. Old features in whose gates too many other features are expected are not offered
to associators (`mapping.measurement.keep_unambiguous`). Pairings with the remaining old features are accepted where
they are hardly all accidental. The true source of a measurement that is paired with an old feature may be another one
that is not mapped yet: a door has two jambs. The number n_i of other features expected in the gate of a pairing, of
size √det S_i, is the mean number of neighbours of a feature within such a gate. The larger of two means is used, over
the features in reach and over the whole map with a circle of the same area, because the features in reach say little
where little is mapped so far. Of l measurements that no recently seen feature explains, k match other features, all
jointly compatible, in

    (l over k) · V_{2k} γ_{2k}^k √det S · Π n_i / (π γ_2 √det S_i)

hypotheses, where S is the covariance of the old features' innovations given the pairings with recently seen ones. A
single pairing is convincing where its gate is narrow. Several pairings together are convincing even where the pose is
poorly known: their errors have the pose in common, so that √det S is far below Π √det S_i.

Whether a robot is where the prediction places it is judged by all pairings of a scan in the same way, with l the number
of all measurements, and n_i as if the features in reach were uniformly distributed (`log_expected_pairings`).

A set of k pairs of newer and older features (`slam.places.loops`) is judged by the same formula. S is the covariance of
the differences of the pairs, l the number of newer features, and n_i the mean over the whole map. Only sets that fit as
well are counted: the D² of the set stands for γ_{2k}. The number counts features that lie at random: it does not tell
whether a building repeats itself.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import gammaln, logsumexp, xlogy

from slam_gym.association.compatibility import chi2_gate, joint_gates
from slam_gym.association.prediction import Prediction
from slam_gym.association.relocation.constraints import difference_covariances, map_arrays, scan_arrays, unary_table
from slam_gym.association.relocation.location import VARIANCE_FLOOR
from slam_gym.types import UNKNOWN_KIND, UNPAIRED, Array, BoolArray, IntArray, Landmarks, Scan

EXPLAINED = 0.7  # fraction of a scan above which no further pairing is required
_SPACED = 100  # number of features that are sampled for the distance to the nearest neighbour
_SAMPLE = 1000  # number of landmarks sampled for their errors and for the unary constraints
_NARROWEST = 1e-3  # [m] minimum extent of a scan


@dataclass(frozen=True, eq=False)
class Crowding:
    """The density of a map's landmarks and their relative errors, for scans of one extent."""

    histogram: IntArray  # (c + 1,) number of landmarks, by the number of other landmarks around them
    area: float  # [m²] in which these others are counted
    variance: float  # [m²] per axis, of a landmark relative to its neighbours


def min_pairings(
    scan: Scan,
    landmarks: Landmarks,
    *,
    confidence: float = 0.99,
    probability: float = 0.02,
    crowding: Crowding | None = None,
) -> int:
    """The least k ≥ 3, at most max(m + 1, 3), for which fewer than `probability` accidental hypotheses are expected.

    One more is required where k pairings explain less than `EXPLAINED` of the scan: see the head of this file.
    `crowding` is that of the map for the extent of the scan, if already known. Raises ValueError as `scan_arrays` and
    `map_arrays` do, and unless 0 < probability < 1.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability: {probability} is not between 0 and 1")
    log_numbers = log_expected(scan, landmarks, confidence=confidence, crowding=crowding)
    pairings = max(3, int(np.flatnonzero(log_numbers >= math.log(probability))[-1]) + 1)
    return max(pairings, min(pairings + 1, math.ceil(EXPLAINED * len(scan))))


def log_expected(
    scan: Scan, landmarks: Landmarks, *, confidence: float = 0.99, crowding: Crowding | None = None
) -> Array:
    """log E_k for k = 0 … m, (m + 1,); inf for k < 2, which any pose explains.

    Raises ValueError as `scan_arrays` and `map_arrays` do; if `crowding` is given, scan and map are assumed checked.
    """
    if crowding is None:
        scan_arrays(scan)
        crowding = crowding_of(landmarks, extent(scan))
    m = len(scan)
    if m < 2:
        return np.full(m + 1, math.inf)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        determinants = np.linalg.det(scan.covariances + crowding.variance * np.eye(2))
        areas = np.sqrt(np.maximum(determinants, VARIANCE_FLOOR**2))
        logs = np.log(areas * _fractions(scan, landmarks, confidence))
        log_spread = 0.5 * np.log(scan.points.var(axis=0, ddof=1).sum())
    expected = np.full(m + 1, -math.inf)  # first log e_k, the elementary symmetric polynomials
    expected[0] = 0.0
    for of_pairing in logs:
        expected[1:] = np.logaddexp(expected[1:], expected[:-1] + of_pairing)
    expected[:2] = math.inf
    expected[2:] += _log_starts(crowding, m)[1:] + _log_tubes(m, confidence) + log_spread - 1.5 * math.log(areas.mean())
    return expected


def extent(scan: Scan) -> float:
    """[m] extent of a scan: twice the largest distance of a measurement from the centroid."""
    if not len(scan):
        return _NARROWEST
    return max(2.0 * float(np.sqrt(((scan.points - scan.points.mean(0)) ** 2).sum(1).max())), _NARROWEST)


def crowding_of(landmarks: Landmarks, width: float) -> Crowding:
    """Densities from counts in squares of `width` [m] around each landmark, errors from pairs within a third of that.

    O(n). Raises ValueError as `map_arrays` does.
    """
    mapped = map_arrays(landmarks)
    others, neighbours = _neighbourhoods(mapped.positions, width / 3.0)
    sample = np.arange(0, len(landmarks), max(len(landmarks) // _SAMPLE, 1))
    paired = sample[neighbours[sample] != UNPAIRED]
    errors = mapped.covariances[sample]
    if len(paired):
        errors = 0.5 * difference_covariances(mapped, paired, neighbours[paired])
    traces = np.maximum(np.trace(errors, axis1=1, axis2=2), 0.0)
    # one uncertain landmark adds one pairing to a hypothesis, and must not widen the gates of all others
    variance = 0.5 * float(np.minimum(traces, 16.0 * np.median(traces)).mean()) if len(errors) else 0.0
    return Crowding(np.bincount(others, minlength=1), width * width, variance)


@functools.lru_cache(maxsize=64)
def _log_starts(crowding: Crowding, orders: int) -> Array:
    """log Σ_j λ_j^p [1/m^2p] for p = 0 … orders − 1."""
    others, powers = np.flatnonzero(crowding.histogram), np.arange(orders)
    counts = crowding.histogram[others]
    if not len(others):
        return np.full(orders, -math.inf)
    fewer = np.maximum(others - powers[:, None], 0)
    falling = gammaln(others + 1.0) - gammaln(fewer + 1.0)
    factorials = logsumexp(np.where(others >= powers[:, None], falling, -math.inf), axis=1, b=counts)
    of_mean = math.log(counts.sum()) + xlogy(powers, (counts * others).sum() / counts.sum())
    starts: Array = np.maximum(factorials, of_mean) - powers * math.log(crowding.area)
    return starts


@functools.lru_cache(maxsize=1024)
def _log_tubes(m: int, confidence: float) -> Array:
    """log 2π k √(k − 1) V_{2k−3} γ^{(2k−3)/2} for k = 2 … m."""
    k = np.arange(2, m + 1)
    dof = 2.0 * k - 3.0
    gates = np.array([chi2_gate(2 * pairings - 3, confidence) for pairings in k.tolist()])
    balls = 0.5 * dof * np.log(math.pi * gates) - gammaln(0.5 * dof + 1.0)
    return np.asarray(math.log(2.0 * math.pi) + np.log(k) + 0.5 * np.log(k - 1.0) + balls)


def _fractions(scan: Scan, landmarks: Landmarks, confidence: float) -> Array:
    """q_i (m,) of measurements; 1 where no size or kind is known."""
    if not (np.isfinite(scan.sizes).any() or (scan.kinds != UNKNOWN_KIND).any()):
        return np.full(len(scan), float(len(landmarks) > 0))
    step = max(len(landmarks) // _SAMPLE, 1)
    attributes = landmarks.sizes[::step], landmarks.size_variances[::step], landmarks.kinds[::step]
    passed = unary_table(scan_arrays(scan)[2:], attributes, chi2_gate(1, confidence))
    fractions: Array = passed.sum(axis=1) / max(passed.shape[1], 1)
    return fractions


def _neighbourhoods(positions: Array, side: float) -> tuple[IntArray, IntArray]:
    """Other points in the 3 × 3 cells of `side` around each point: number (n,), and the one before it in its own cell
    (n,), or UNPAIRED.

    Cells are hashed into a table, where distinct cells may collide. This can only make the map look more crowded: by
    about one point on average, of any number of points.
    """
    n = len(positions)
    size = 1 << max(6, (8 * n - 1).bit_length())
    with np.errstate(invalid="ignore"):
        x, y = np.floor(positions / side).astype(np.int64).T

    def cells_at(dx: int, dy: int) -> IntArray:
        return np.asarray(((x + dx) * 73856093 ^ (y + dy) * 19349663) & (size - 1))

    own, neighbours = cells_at(0, 0), np.full(n, UNPAIRED)
    counts, order = np.bincount(own, minlength=size), np.argsort(own, kind="stable")
    shared = own[order[1:]] == own[order[:-1]]
    neighbours[order[1:][shared]] = order[:-1][shared]
    others = np.sum([counts[cells_at(dx, dy)] for dx in (-1, 0, 1) for dy in (-1, 0, 1)], axis=0) - 1
    return others, neighbours


def are_accidental(scan: Scan, prediction: Prediction, features: IntArray, max_probability: float) -> BoolArray:
    """(m,) which pairings of a scan with `features` (m,) are rejected: all those with old features, or none.

    They are rejected where more than `max_probability` accidental hypotheses of as many pairings are expected.
    """
    old = np.isin(features, prediction.features[~prediction.near])
    possible = old.any() and max_probability > 0.0
    if possible and log_expected_old(scan, prediction, features, old) <= math.log(max_probability):
        old[:] = False
    return old


def log_expected_old(scan: Scan, prediction: Prediction, features: IntArray, old: BoolArray) -> float:
    """log of the expected number of accidental hypotheses (see the head of this file) with as many pairings with old
    features as `old` (m,) marks among the pairings of a scan with `features` (m,). The pairings with near features are
    held fixed."""
    near = np.flatnonzero(np.isin(features, prediction.features[prediction.near]))
    paired = np.concatenate([near, np.flatnonzero(old)])
    S, every_block = _innovations(scan, prediction, features, paired)
    blocks = every_block[len(near) :]
    sizes = np.sqrt(np.linalg.det(blocks))
    log_det = np.linalg.slogdet(S)[1] - np.linalg.slogdet(S[: 2 * len(near), : 2 * len(near)])[1]
    n, state, gate = prediction.expected.n, prediction.expected.state, chi2_gate(2, prediction.confidence)
    everywhere = _others_in_gates(state[3 : 3 + 2 * n].reshape(n, 2), gate * sizes)
    confirmed = prediction.positions[~prediction.provisional]
    sample = confirmed[:: max(len(confirmed) // _SPACED, 1)]
    differences = sample[:, None] - confirmed[None]
    squared = np.einsum("abi,kij,abj->kab", differences, np.linalg.inv(blocks), differences)
    in_reach = (squared < gate).sum(axis=(1, 2)) / max(len(sample), 1) - 1.0
    others = np.maximum(everywhere, in_reach)
    return _log_expected_sets(len(features) - len(near), float(log_det), others, sizes, prediction.confidence)


def log_expected_pairings(scan: Scan, prediction: Prediction, features: IntArray) -> float:
    """log of the expected number of accidental hypotheses with as many pairings as that of a scan with `features` (m,),
    of a robot that is not where the prediction places it, among the features in reach as if these were uniformly
    distributed; inf without pairings."""
    paired = np.flatnonzero(np.isin(features, prediction.features))
    if not len(paired):
        return math.inf
    squared_reach = max(float((prediction.positions**2).sum(axis=1).max()), VARIANCE_FLOOR)
    in_gate_of_1 = len(prediction) * chi2_gate(2, prediction.confidence) / squared_reach
    others, sizes = np.full(len(paired), in_gate_of_1), np.ones(len(paired))
    log_det = float(np.linalg.slogdet(_innovations(scan, prediction, features, paired)[0])[1])
    return _log_expected_sets(len(features), log_det, others, sizes, prediction.confidence)


def _innovations(scan: Scan, prediction: Prediction, features: IntArray, paired: IntArray) -> tuple[Array, Array]:
    """The joint covariance (2p, 2p) of the innovations of the pairings of measurements `paired` (p,) with `features`
    (m,), and its blocks (p, 2, 2)."""
    rows, noise, p = np.searchsorted(prediction.features, features[paired]), scan.covariances[paired], len(paired)
    S = prediction.joint(rows)
    S.reshape(p, 2, p, 2)[np.arange(p), :, np.arange(p), :] += noise
    return S, prediction.covariances[rows] + noise


def log_expected_pairs(nu: Array, S: Array, choices: int, positions: Array, confidence: float) -> float:
    """log of the expected number of accidental sets of k pairs of a newer and an older feature that fit as well as this
    one (see the head of this file), where k of `choices` newer features are paired; inf if S is singular.

    Arguments:
        nu: (2k,) [m] differences of the pairs.
        S: (2k, 2k) [m²] their covariance.
        positions: (n, 2) [m] of the features of the map.
        confidence: of the gate that all sets pass.
    """
    k, (sign, log_det) = len(S) // 2, np.linalg.slogdet(S)
    if sign <= 0.0:
        return math.inf
    sizes = np.sqrt(np.linalg.det(S.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k), :]))
    others = _others_in_gates(positions, chi2_gate(2, confidence) * sizes)
    distance = max(float(nu @ np.linalg.solve(S, nu)), VARIANCE_FLOOR)
    return _log_expected_sets(choices, float(log_det), others, sizes, confidence, distance)


def _others_in_gates(positions: Array, squared_radii: Array) -> Array:
    """(k,) mean number of other features around a feature within each of the radii (k,), more than 0.

    Among n features no fraction below 1 / n is counted. In so narrow a gate the number is that of a Poisson process
    with the same median distance to the nearest neighbour, d: n_i = ln 2 (r / d)².
    """
    tree, n = cKDTree(positions), len(positions)
    sample = positions[:: max(n // _SPACED, 1)]
    nearest = float(np.median(tree.query(sample, k=2)[0][:, 1]))
    poisson = math.log(2.0) * squared_radii / nearest**2 if 0.0 < nearest < math.inf else math.inf
    counted = tree.count_neighbors(tree, np.sqrt(squared_radii)) / n - 1.0
    others: Array = np.maximum(counted, np.minimum(poisson, 1.0 / n))
    return others


def _log_expected_sets(
    choices: int, log_det: float, others: Array, sizes: Array, confidence: float, distance: float = math.inf
) -> float:
    """log (l over k) V_{2k} γ_{2k}^k √det S Π n_i / (π γ_2 √det S_i), with l the choices, n_i `others` (k,), and
    √det S_i `sizes` (k,). A `distance` below γ_{2k} takes its place."""
    k, gates = len(sizes), joint_gates(len(sizes), confidence)
    log_densities = np.log(others / (math.pi * gates[1] * sizes))
    log_choices = gammaln(choices + 1) - gammaln(k + 1) - gammaln(choices - k + 1)
    log_volume = k * math.log(math.pi * min(distance, gates[k])) - gammaln(k + 1) + 0.5 * log_det
    return float(log_choices + log_volume + log_densities.sum())
