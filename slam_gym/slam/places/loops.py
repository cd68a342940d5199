"""Loops: features of the recent part of a map that are the same as older ones, found with the map as the prior.

A pair of an older feature j and a newer one i has the innovation ν = F_i − F_j. The map knows the joint covariance of
the innovations of all pairs (`slam.places.verification`), and with it how far the robot may have drifted since, and how
the recent part may bend. The pairs of a loop are jointly compatible; those of other places hardly ever are.

**Search.** A set of pairs grows from one pair. In each step the innovations of all other pairs are conditioned on those
of the set, as by a Kalman update, and of the pairs that are still compatible the one with the least D² + log det S is
added, the one with the highest likelihood. The set is complete when none is left. One pair determines the shift and a
second one the turn of the recent part; filters become optimistic in both, so the gates of these two are wide. The
largest set over all first pairs is verified.

**Acceptance.** Fewer than `RecognitionSpec.max_accidental_loops` sets of as many pairs are expected by chance
(`association.acceptance`), the pairs are most of the features where both parts overlap, and no scan saw both features
of any pair.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.acceptance import log_expected_pairs
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation.location import VARIANCE_FLOOR
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.places.recognition import Parts, RecognitionSpec, parts_of
from slam_gym.slam.places.verification import agreeing, attributes_agree, difference_covariance, overlap
from slam_gym.types import Array, IntArray

NO_PAIRS = np.empty((0, 2), np.int64)
_SEEDS = 400  # most pairs from which sets grow


def find_loop(m: StochasticMap, graph: CovisibilityGraph, spec: RecognitionSpec) -> IntArray:
    """Pairs (k, 2) of an older feature and one of the recent part that are the same; empty if no loop is accepted."""
    parts = parts_of(m, graph, spec)
    if parts is None:
        return NO_PAIRS
    pairs = agreeing(m, compatible_pairs(m, parts, spec), spec, prior=True)
    if not len(pairs) or any(graph.count(older, newer) for older, newer in pairs.tolist()):
        return NO_PAIRS
    unlikely = _log_expected(m, parts, pairs, spec) <= math.log(spec.max_accidental_loops)
    return pairs if unlikely and overlap(m, parts, pairs) >= spec.min_fraction else NO_PAIRS


def compatible_pairs(m: StochasticMap, parts: Parts, spec: RecognitionSpec) -> IntArray:
    """The largest set of pairs (k, 2) found of an older and a newer feature that the map considers jointly compatible,
    sorted by the older; each feature is in one pair."""
    gate = chi2_gate(2, spec.confidence)
    wide_gate = spec.inflation**2 * gate
    possible = np.isfinite(m.distances_between(parts.recent, parts.older, wide_gate))
    newer, older = np.nonzero(possible & attributes_agree(m, parts.older, parts.recent))
    features = np.concatenate([parts.older, parts.recent])
    rows = np.column_stack([older, len(parts.older) + newer])
    gates, most = np.array([wide_gate, gate]), len(parts.recent)
    found = _largest_set(m.positions[features], m.covariance_of(features), rows, gates, most)
    pairs: IntArray = features[rows[found]]
    return pairs[np.argsort(pairs[:, 0])]


def _log_expected(m: StochasticMap, parts: Parts, pairs: IntArray, spec: RecognitionSpec) -> float:
    """log of the expected number of accidental sets of as many pairs; the drift may be `inflation` times as large."""
    S = difference_covariance(m, pairs) + VARIANCE_FLOOR * np.eye(2 * len(pairs))
    established = m.positions[~m.provisional]
    inflated = 3.0 * math.log(spec.inflation)  # of √det S, in the three directions of the motion between the parts
    return log_expected_pairs(S, len(parts.recent), established, spec.confidence) + inflated


@compiled
def _largest_set(positions: Array, P: Array, pairs: IntArray, gates: Array, most: int) -> IntArray:
    """The largest of the sets that grow from the likeliest pairs, as indices into `pairs`.

    Arguments:
        positions: (u, 2) [m] of features, with covariance P (2u, 2u).
        pairs: (k, 2) an older and a newer feature each.
        gates: (2,) χ² gate of the second pair of a set, and of all later ones.
        most: most pairs of a set.
    """
    best, nu, S = np.empty(0, np.int64), np.empty((len(pairs), 2)), np.empty((len(pairs), 2, 2))
    scores = np.empty(len(pairs))
    for p in range(len(pairs)):
        for a in range(2):
            nu[p, a] = positions[pairs[p, 1], a] - positions[pairs[p, 0], a]
            for b in range(2):
                S[p, a, b] = _covariance(P, pairs[p], a, pairs[p], b)
            S[p, a, a] += VARIANCE_FLOOR
        distance, determinant = _distance(nu[p], S[p])
        scores[p] = distance + math.log(determinant)
    for seed in np.argsort(scores)[:_SEEDS]:
        grown = _grow(P, pairs, nu.copy(), S.copy(), gates, seed, most)
        if len(grown) > len(best):
            best = grown
    return best


@compiled
def _grow(P: Array, pairs: IntArray, nu: Array, S: Array, gates: Array, seed: int, most: int) -> IntArray:
    """The set that grows from the pair `seed`. The innovations ν (k, 2) and S (k, 2, 2) are conditioned in place.

    The coordinates of a pair are conditioned on one after the other. With w_q = Cov(q, r) / σ_r the covariance of q and
    an earlier coordinate r, given those before, each coordinate changes ν by −w ν_r / σ_r and S by −w wᵀ.
    """
    possible, chosen, size = np.ones(len(pairs), np.bool_), np.empty(most, np.int64), 0
    w, added = np.empty((len(pairs), 2 * most, 2)), seed
    while added >= 0:
        chosen[size], possible[added] = added, False
        for q in range(len(pairs)):
            if pairs[q, 0] == pairs[added, 0] or pairs[q, 1] == pairs[added, 1]:
                possible[q] = False
        for a in range(2):
            r, sigma = 2 * size + a, math.sqrt(max(S[added, a, a], VARIANCE_FLOOR))
            normalised = nu[added, a] / sigma
            for q in range(len(pairs)):
                if not (possible[q] or q == added):
                    continue
                for b in range(2):
                    covariance = _covariance(P, pairs[added], a, pairs[q], b)
                    for earlier in range(r):
                        covariance -= w[added, earlier, a] * w[q, earlier, b]
                    w[q, r, b] = covariance / sigma
                for b in range(2):
                    nu[q, b] -= w[q, r, b] * normalised
                    for c in range(2):
                        S[q, b, c] -= w[q, r, b] * w[q, r, c]
        size, added, least = size + 1, -1, np.inf
        for q in range(len(pairs) if size < most else 0):
            if possible[q]:
                distance, determinant = _distance(nu[q], S[q])
                possible[q] = distance < gates[min(size, 2) - 1]
                score = distance + math.log(determinant)
                if possible[q] and score < least:
                    least, added = score, q
    return chosen[:size]


@compiled
def _covariance(P: Array, one: IntArray, a: int, other: IntArray, b: int) -> float:
    """Covariance of coordinate a of the innovation of a pair with coordinate b of that of another pair."""
    (i, j), (k, l) = (2 * one[1] + a, 2 * one[0] + a), (2 * other[1] + b, 2 * other[0] + b)
    covariance: float = P[i, k] - P[i, l] - P[j, k] + P[j, l]
    return covariance


@compiled
def _distance(nu: Array, S: Array) -> tuple[float, float]:
    """D² = νᵀ S⁻¹ ν, and det S, not below that of variances at the floor."""
    determinant = max(S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0], VARIANCE_FLOOR**2)
    squared = S[1, 1] * nu[0] ** 2 - (S[0, 1] + S[1, 0]) * nu[0] * nu[1] + S[0, 0] * nu[1] ** 2
    return squared / determinant, determinant
