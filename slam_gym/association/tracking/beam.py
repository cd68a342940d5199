"""Beam search of the interpretation tree for the hypotheses of greatest density, level by level.

A hypothesis H scores log N(ν_H; 0, S_H) + Σ gain over its features + `unpaired` for every measurement decided `*`. With
S_H = L Lᵀ kept as in `tree.append_pairing`, log N(ν_H; 0, S_H) = −½ D²_H − Σ log L_ii − |H| log 2π, so each pairing
adds a term of its own, and hypotheses over the same measurements compare at every level.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.tracking.support import Arrays
from slam_gym.association.tree import append_pairing
from slam_gym.types import NONE, Array, IntArray

_LOG_TWO_PI = math.log(2.0 * math.pi)


class Beam(NamedTuple):
    """Hypotheses kept, best first."""

    chosen: IntArray  # (B, l) candidate taken at each level, NONE for `*`
    path: IntArray  # (B, P) slots paired, the given ones first
    pairings: IntArray  # (B,)
    factor: Array  # (B, 2P, 2P) L
    whitened: Array  # (B, 2P) y
    score: Array  # (B,)


@compiled
def search(
    levels: IntArray,
    candidates: Arrays,
    path: IntArray,
    factor: Array,
    whitened: Array,
    given: int,
    gain: Array,
    unpaired: float,
    width: int,
    margin: float,
) -> tuple[tuple[IntArray, IntArray, IntArray, Array, Array, Array], int, int, bool]:
    """The best hypotheses, as a `Beam` of b of them; nodes; joint tests; cut off.

    `levels` (l, 2) bounds the candidates of each level, in the order of decision. `path`, `factor` and `whitened` hold
    the given pairings, with room for one more than can follow. gain (u,) by slot. At each level at most `width`
    hypotheses are kept, and none that scores `margin` less than the best; cut off: the width turned some away.
    """
    slots, measured, innovations, noise, covariance, _ = candidates
    depth, room = len(levels), len(path)
    beam, other = _room_for(width, depth, room), _room_for(width, depth, room)
    beam.path[0], beam.factor[0], beam.whitened[0] = path, factor, whitened
    beam.pairings[0], beam.score[0] = given, 0.0
    most = 1
    for level in range(depth):
        most = max(most, levels[level, 1] - levels[level, 0] + 1)
    parents, offered = np.empty(width * most, np.int64), np.empty(width * most, np.int64)
    scores = np.empty(width * most)
    kept, nodes, tests, cut = 1, 0, 0, False
    for level in range(depth):
        count, best = 0, -math.inf
        for b in range(kept):
            parents[count], offered[count], scores[count] = b, NONE, beam.score[b] + unpaired
            best = max(best, scores[count])
            count += 1
            for c in range(levels[level, 0], levels[level, 1]):
                if not _may_follow(beam, b, given, slots[c], candidates):
                    continue
                tests += 1
                score = beam.score[b] + gain[slots[c]] + _log_density(beam, b, c, candidates)
                if score > best - margin:
                    parents[count], offered[count], scores[count] = b, c, score
                    best = max(best, score)
                    count += 1
        order = np.argsort(-scores[:count], kind="mergesort")
        kept = 0
        for k in order:
            if scores[k] < best - margin:
                break
            if kept == width:
                cut = True
                break
            _inherit(beam, other, parents[k], kept, level)
            other.chosen[kept, level], other.score[kept] = offered[k], scores[k]
            if offered[k] != NONE:
                c, p = offered[k], other.pairings[kept]
                append_pairing(
                    other.factor[kept],
                    other.whitened[kept],
                    other.path[kept],
                    p,
                    covariance,
                    slots[c],
                    innovations[c],
                    noise[measured[c]],
                )
                other.path[kept, p] = slots[c]
                other.pairings[kept] = p + 1
            kept += 1
        nodes += kept
        beam, other = other, beam
    found = (beam.chosen[:kept], beam.path[:kept], beam.pairings[:kept], beam.factor[:kept], beam.whitened[:kept])
    return (*found, beam.score[:kept]), nodes, tests, cut


@compiled
def updated(
    path: IntArray, pairings: int, factor: Array, whitened: Array, positions: Array, covariance: Array
) -> tuple[Array, Array]:
    """Positions (k, 2) and covariances (k, 2, 2) of features after an update with a hypothesis of the beam.

    positions (k, 2) and covariance (2k, 2k) are those predicted; slot s is feature s. With W = L⁻¹ S_{H,k}, what is
    added is Wᵀ y, what is taken away Wᵀ W.
    """
    k, d = len(positions), 2 * pairings
    moved, left, w = positions.copy(), np.empty((k, 2, 2)), np.empty((d, 2))
    for j in range(k):
        for a in range(2):
            for b in range(2):
                left[j, a, b] = covariance[2 * j + a, 2 * j + b]
        for r in range(d):
            row = 2 * path[r // 2] + r % 2
            for a in range(2):
                w[r, a] = covariance[row, 2 * j + a]
                for q in range(r):
                    w[r, a] -= factor[r, q] * w[q, a]
                w[r, a] /= factor[r, r]
                moved[j, a] += w[r, a] * whitened[r]
            for a in range(2):
                for b in range(2):
                    left[j, a, b] -= w[r, a] * w[r, b]
        for a in range(2):
            left[j, a, a] = max(left[j, a, a], 0.0)
    return moved, left


@compiled
def _room_for(width: int, depth: int, room: int) -> Beam:
    return Beam(
        np.empty((width, depth), np.int64),
        np.empty((width, room), np.int64),
        np.zeros(width, np.int64),
        np.empty((width, 2 * room, 2 * room)),
        np.empty((width, 2 * room)),
        np.empty(width),
    )


@compiled
def _may_follow(beam: Beam, b: int, given: int, slot: int, candidates: Arrays) -> bool:
    """The feature is not taken, and local to the first one paired after those given."""
    local = candidates[5]
    for q in range(beam.pairings[b]):
        if beam.path[b, q] == slot:
            return False
    if local.size > 0 and beam.pairings[b] > given:
        return bool(local[beam.path[b, given], slot])
    return True


@compiled
def _log_density(beam: Beam, b: int, c: int, candidates: Arrays) -> float:
    """log of N(ν; 0, S) of candidate c given the pairings of hypothesis b; −inf where S is singular."""
    slots, measured, innovations, noise, covariance, _ = candidates
    p, L = beam.pairings[b], beam.factor[b]
    added = append_pairing(
        L, beam.whitened[b], beam.path[b], p, covariance, slots[c], innovations[c], noise[measured[c]]
    )
    if added == math.inf:
        return -math.inf
    return -0.5 * added - math.log(L[2 * p, 2 * p] * L[2 * p + 1, 2 * p + 1]) - _LOG_TWO_PI


@compiled
def _inherit(beam: Beam, other: Beam, b: int, to: int, level: int) -> None:
    """Hypothesis `to` of the other beam becomes a copy of hypothesis b."""
    p = beam.pairings[b]
    other.pairings[to] = p
    for k in range(level):
        other.chosen[to, k] = beam.chosen[b, k]
    for q in range(p):
        other.path[to, q] = beam.path[b, q]
    for r in range(2 * p):
        other.whitened[to, r] = beam.whitened[b, r]
        for q in range(r + 1):
            other.factor[to, r, q] = beam.factor[b, r, q]
