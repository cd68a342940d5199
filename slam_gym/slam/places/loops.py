"""Loops: features of the recent part of a map that are the same as older ones, found with the map as the prior.

A pair of an older feature j and a newer one i has the innovation ν = F_i − F_j. The map knows the joint covariance of
the innovations of all pairs (`slam.places.verification`), and with it how far the robot may have drifted since, and how
the recent part may bend. The pairs of a loop are jointly compatible.

**Search.** A set of pairs grows from one pair. In each step the innovations of all other pairs are conditioned on those
of the set, as by a Kalman update, and of the pairs that are still compatible the one with the least D² + log det S is
added, the one with the highest likelihood. The set is complete when none is left. One pair determines the shift and a
second one the turn of the recent part; filters become optimistic in both, so the gates of these two are wide. A robot
may return with a heading that is wrong by tens of degrees, for which no linear test holds: after each pair, the
innovations are corrected for the turn that the set implies (`mapping.update.heading_correction`). Sets grow from all
pairs of as many recent features as `_SEEDS` allows, and the largest set is verified, of equals the likeliest. Pairs
whose features were seen together in one scan are not the same feature, and are left out.

**Acceptance.** Buildings repeat themselves: a corridor may fit another one, or itself, a door further on. So the loop
must have `RecognitionSpec.margin` pairs more than the largest set that shares no pair with it. Besides, fewer than
`max_accidental_loops` sets of as many pairs that fit as well are expected by chance (`association.acceptance`), and of
the two parts the one with fewer features in the circle around its paired ones has at least `min_fraction` of them
paired.
"""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.acceptance import log_expected_pairs
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation.location import VARIANCE_FLOOR
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.mapping.update import heading_correction, left_jacobian_inverse
from slam_gym.slam.places.recognition import Parts, RecognitionSpec, parts_of
from slam_gym.slam.places.verification import agreeing, attributes_agree, heading_covariances, innovation, overlap
from slam_gym.types import Array, IntArray

NO_PAIRS = np.empty((0, 2), np.int64)
_SEEDS = 800  # most pairs from which sets grow; one recent feature may have more
_MOST_PAIRS = 20_000  # with more possible pairs, the prior is too weak, and nothing is searched for


def find_loop(m: StochasticMap, graph: CovisibilityGraph, spec: RecognitionSpec) -> IntArray:
    """Pairs (k, 2) of features that are the same, the older one first; empty if no loop is accepted."""
    parts = parts_of(m, graph, spec, spec.min_loop_pairs)
    if parts is None:
        return NO_PAIRS
    pairs, rival = compatible_pairs(m, graph, parts, spec)
    pairs = agreeing(m, pairs, spec, prior=True)
    if len(pairs) < max(rival + spec.margin, 1) or overlap(m, parts, pairs) < spec.min_fraction:
        return NO_PAIRS
    (nu, S), established = innovation(m, pairs), m.positions[~m.provisional]
    inflated = 3.0 * math.log(spec.inflation)  # of √det S, in the three directions of the motion between the parts
    log_expected = log_expected_pairs(nu, S, len(parts.recent), established, spec.confidence) + inflated
    if log_expected > math.log(spec.max_accidental_loops):
        return NO_PAIRS
    by_age: IntArray = np.sort(pairs, axis=1)  # a feature seen lately may have been mapped first
    return by_age[np.argsort(by_age[:, 0])]


def compatible_pairs(
    m: StochasticMap, graph: CovisibilityGraph, parts: Parts, spec: RecognitionSpec
) -> tuple[IntArray, int]:
    """The largest set found of pairs (k, 2) of an older and a newer feature that the map considers jointly compatible,
    and the size of the largest one that shares no pair with it. In a set, each feature is in one pair.

    Returns no pairs where more than `_MOST_PAIRS` are possible.
    """
    gate = chi2_gate(2, spec.confidence)
    wide_gate = spec.inflation**2 * gate
    possible = np.isfinite(m.distances_between(parts.recent, parts.older, wide_gate))
    together = [np.isin(parts.older, graph.neighbours(feature)) for feature in parts.recent.tolist()]
    possible &= attributes_agree(m, parts.older, parts.recent) & ~np.array(together)
    newer, older = np.nonzero(possible)
    if not 0 < len(newer) <= _MOST_PAIRS:
        return NO_PAIRS, 0
    pairs = np.column_stack([parts.older[older], parts.recent[newer]])
    recent, most = np.unique(newer), max(_SEEDS * len(parts.recent) // len(newer), 1)
    chosen = recent[np.linspace(0, len(recent) - 1, min(most, len(recent))).astype(np.int64)]  # evenly spaced
    seeds, (_, P, *_) = np.flatnonzero(np.isin(newer, chosen)), m.arrays
    given = m.positions[pairs[:, 1]] - m.positions[pairs[:, 0]], heading_covariances(m, pairs)
    sets, scores = _grow_sets(P, pairs, given, seeds, np.array([wide_gate, gate]), len(parts.recent))
    sizes = (sets >= 0).sum(axis=1)
    best = sets[np.lexsort((scores, -sizes))[0], : sizes.max()]
    rivals = sizes[~np.isin(sets, best).any(axis=1)]
    found: IntArray = pairs[best]
    return found[np.argsort(found[:, 0])], int(rivals.max(initial=0))


@compiled
def _grow_sets(
    P: Array, pairs: IntArray, given: tuple[Array, Array], seeds: IntArray, gates: Array, most: int
) -> tuple[IntArray, Array]:
    """The set that grows from each of the pairs `seeds` (s,), as indices into `pairs`, then −1 (s, most); and the sum
    of D² + log det S over its pairs (s,), each given those before.

    Arguments:
        P: (≥ 3 + 2n, ≥ 3 + 2n) covariance of the map, of which the upper triangle is used.
        pairs: (k, 2) an older and a newer feature each.
        given: (k, 2) F_i − F_j of each pair of an older feature j and a newer one i, and (k, 2) the covariance of the
            heading with F_j − F_i (see `verification.heading_covariances`).
        gates: (2,) χ² gate of the second pair of a set, and of all later ones.
        most: most pairs of a set.
    """
    sets, scores = np.full((len(seeds), most), -1), np.empty(len(seeds))
    w, S = np.empty((2 * most, len(pairs), 2)), np.empty((len(pairs), 2, 2))
    for p in range(len(pairs)):
        for a in range(2):
            for b in range(2):
                S[p, a, b] = _covariance(P, pairs[p], a, pairs[p], b)
            S[p, a, a] += VARIANCE_FLOOR
    for s in range(len(seeds)):
        scores[s] = _grow(P, pairs, given, S.copy(), gates, seeds[s], w, sets[s])
    return sets, scores


@compiled
def _grow(
    P: Array, pairs: IntArray, given: tuple[Array, Array], S: Array, gates: Array, seed: int, w: Array, chosen: IntArray
) -> float:
    """Enter the set that grows from the pair `seed` in `chosen` (most,); returns the sum of D² + log det S.

    ν (k, 2) and S (k, 2, 2) are conditioned on the coordinates of each chosen pair one after the other. With
    w_q = Cov(q, r) / σ_r the covariance of q and an earlier coordinate r, given those before, each coordinate changes S
    by −w wᵀ, in place, and ν by −w e_r, where e_r is the conditioned innovation of r over σ_r: e = L⁻¹ ν, with L Lᵀ the
    covariance of the set. ν is computed again after each pair, since the correction of the heading that the set implies
    changes. `w` (2 most, k, 2) is working memory.
    """
    possible, added = np.arange(len(pairs)), seed  # the pairs that may still be added, and the one that is
    (differences, of_heading), inverse, gain = given, np.zeros((len(w), len(w))), np.zeros(len(w))  # L⁻¹; gain of δθ
    nu = differences.copy()
    distance, determinant = _distance(nu[seed], S[seed])
    total = distance + math.log(determinant)
    for size in range(len(chosen)):
        chosen[size] = added
        so_far, rows = chosen[: size + 1], 2 * size + 2
        for a in range(2):
            r, sigma = 2 * size + a, math.sqrt(max(S[added, a, a], VARIANCE_FLOOR))
            inverse[r, r] = 1.0
            for earlier in range(r):
                inverse[r] -= w[earlier, added, a] * inverse[earlier]
            inverse[r] /= sigma
            gain += inverse[r] * (inverse[r, :rows] * of_heading[so_far].ravel()).sum()
            for q in possible:
                for b in range(2):
                    covariance = _covariance(P, pairs[added], a, pairs[q], b)
                    for earlier in range(r):
                        covariance -= w[earlier, added, a] * w[earlier, q, b]
                    w[r, q, b] = covariance / sigma
                for b in range(2):
                    for c in range(2):
                        S[q, b, c] -= w[r, q, b] * w[r, q, c]
        nu = left_jacobian_inverse(differences, heading_correction(differences[so_far], gain[:rows]))
        of_set = nu[so_far].ravel()
        for r in range(rows):
            e = (inverse[r, :rows] * of_set).sum()
            for q in possible:
                nu[q, 0] -= w[r, q, 0] * e
                nu[q, 1] -= w[r, q, 1] * e
        left, likeliest, least = 0, -1, np.inf
        for q in possible:
            if pairs[q, 0] != pairs[added, 0] and pairs[q, 1] != pairs[added, 1]:
                distance, determinant = _distance(nu[q], S[q])
                if distance < gates[min(size, 1)]:
                    possible[left] = q
                    left += 1
                    if distance + math.log(determinant) < least:
                        likeliest, least = int(q), distance + math.log(determinant)
        if left == 0:
            break
        possible, added, total = possible[:left], likeliest, total + least
    return total


@compiled
def _covariance(P: Array, one: IntArray, a: int, other: IntArray, b: int) -> float:
    """Covariance of coordinate a of the innovation of a pair with coordinate b of that of another pair."""
    i, j, k, l = 3 + 2 * one[1] + a, 3 + 2 * one[0] + a, 3 + 2 * other[1] + b, 3 + 2 * other[0] + b
    same: float = P[min(i, k), max(i, k)] + P[min(j, l), max(j, l)]
    crossed: float = P[min(i, l), max(i, l)] + P[min(j, k), max(j, k)]
    return same - crossed


@compiled
def _distance(nu: Array, S: Array) -> tuple[float, float]:
    """D² = νᵀ S⁻¹ ν and det S, of an S whose variances are at least the floor."""
    xx, yy, xy = max(S[0, 0], VARIANCE_FLOOR), max(S[1, 1], VARIANCE_FLOOR), 0.5 * (S[0, 1] + S[1, 0])
    determinant = max(xx * yy - xy * xy, VARIANCE_FLOOR**2)
    squared = yy * nu[0] ** 2 - 2.0 * xy * nu[0] * nu[1] + xx * nu[1] ** 2
    return max(squared, 0.0) / determinant, determinant
