"""Beam search of the interpretation tree for the hypotheses of greatest density, level by level.

A hypothesis H scores log N(ν_H; 0, S_H) + Σ gain over its features + `unpaired` for every measurement decided `*`.
log N(ν_H; 0, S_H) is the sum of log N(e_c; 0, S_c|H) over its pairings, each given those before it: each pairing adds a
term of its own, and hypotheses over the same measurements compare at every level.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled, inlined
from slam_gym.association.tracking.path import Path, after, append, follow
from slam_gym.association.tree import Innovation, Pairings, may_follow, squared
from slam_gym.types import UNPAIRED, Array, IntArray

_LOG_TWO_PI = math.log(2.0 * math.pi)


class Prices(NamedTuple):
    """What hypotheses score beside log N(ν_H; 0, S_H), and which are kept."""

    gains: Array  # (u,) by slot, for pairing it
    unpaired: float  # for a measurement decided `*`
    width: int  # hypotheses kept at each level
    margin: float  # none is kept that scores so much less than the best


class Beam(NamedTuple):
    """Hypotheses kept, best first."""

    chosen: IntArray  # (B, l) pairing taken at each level, UNPAIRED for `*`
    pairings: IntArray  # (B,) number of pairings, those given included
    score: Array  # (B,) those given included, but for their gains
    paths: Path  # arrays (B, …)


class BeamSearch(NamedTuple):
    """What a beam search came to."""

    beam: Beam
    nodes: int
    tests: int  # joint tests
    cut: bool  # the width turned hypotheses away


class Moved(NamedTuple):
    """Features after an update with each hypothesis."""

    positions: Array  # (b, k, 2) [m]
    covariances: Array  # (b, k, 2, 2) [m²]


@compiled
def search(pairings: Pairings, levels: IntArray, prices: Prices) -> BeamSearch:
    """The best hypotheses over levels whose pairings begin and end at `levels` (l, 2), in the order of decision."""
    depth, width, most = len(levels), prices.width, 1
    room = pairings.given + max(min(depth, len(pairings.covariance) // 2), 1) + 1
    beam, other = _empty(width, depth, room), _empty(width, depth, room)
    _begin(pairings, beam)
    for level in range(depth):
        most = max(most, levels[level, 1] - levels[level, 0] + 1)
    parents, offered = np.empty(width * most, np.int64), np.empty(width * most, np.int64)
    scores = np.empty(width * most)
    kept, nodes, tests, cut = 1, 0, 0, False
    for level in range(depth):
        count, best = 0, -math.inf
        for b in range(kept):
            parents[count], offered[count], scores[count] = b, UNPAIRED, beam.score[b] + prices.unpaired
            best = max(best, scores[count])
            count += 1
            path, p = _path(beam, b), beam.pairings[b]
            for c in range(levels[level, 0], levels[level, 1]):
                if not may_follow(pairings, path.pairings, p, c):
                    continue
                tests += 1
                density = _log_density(follow(pairings, path, p, c))
                score = beam.score[b] + prices.gains[pairings.slots[c]] + density
                if score > best - prices.margin:
                    parents[count], offered[count], scores[count] = b, c, score
                    best = max(best, score)
                    count += 1
        kept = 0
        for k in np.argsort(-scores[:count], kind="mergesort"):
            if scores[k] < best - prices.margin:
                break
            if kept == width:
                cut = True
                break
            _inherit(beam, other, parents[k], kept, level)
            other.chosen[kept, level], other.score[kept] = offered[k], scores[k]
            if offered[k] != UNPAIRED:
                c, p, path = offered[k], other.pairings[kept], _path(other, kept)
                append(path, p, c, follow(pairings, path, p, c))
                other.pairings[kept] = p + 1
            kept += 1
        nodes += kept
        beam, other = other, beam
    return BeamSearch(_first(beam, kept), nodes, tests, cut)


@compiled
def updated(pairings: Pairings, beam: Beam, positions: Array) -> Moved:
    """Features after an update with each hypothesis of the beam.

    positions (k, 2) are those predicted, the covariance of `pairings` (2k, 2k); slot s is feature s. What a feature
    would be measured at, free of noise, is conditioned on the path like any candidate.
    """
    hypotheses, k, P = len(beam.score), len(positions), pairings.covariance
    moved, left = np.empty((hypotheses, k, 2)), np.empty((hypotheses, k, 2, 2))
    for b in range(hypotheses):
        path, p = _path(beam, b), beam.pairings[b]
        for j in range(k):
            s, out = 2 * j, left[b, j]
            e = after(pairings, path, p, j, Innovation(0.0, 0.0, P[s, s], P[s, s + 1], P[s + 1, s + 1]))
            moved[b, j, 0], moved[b, j, 1] = positions[j, 0] - e.x, positions[j, 1] - e.y
            out[0, 0], out[0, 1], out[1, 0], out[1, 1] = max(e.xx, 0.0), e.xy, e.xy, max(e.yy, 0.0)
    return Moved(moved, left)


@compiled
def _empty(width: int, depth: int, room: int) -> Beam:
    paths = Path(np.zeros((width, room), np.int64), np.empty((width, room, 5)), np.empty((width, room, 2 * room, 2)))
    return Beam(np.empty((width, depth), np.int64), np.zeros(width, np.int64), np.zeros(width), paths)


@inlined
def _path(beam: Beam, b: int) -> Path:
    return Path(beam.paths.pairings[b], beam.paths.pivots[b], beam.paths.w[b])


@compiled
def _begin(pairings: Pairings, beam: Beam) -> None:
    """Hypothesis 0 becomes that of the given pairings."""
    path = _path(beam, 0)
    for d in range(pairings.given):
        e = follow(pairings, path, d, d)
        append(path, d, d, e)
        beam.score[0] += _log_density(e)
    beam.pairings[0] = pairings.given


@inlined
def _log_density(e: Innovation) -> float:
    """log N(e; 0, S); −inf where S is singular."""
    distance = squared(e)
    if distance == math.inf:
        return -math.inf
    return -0.5 * distance - 0.5 * math.log(e.xx * e.yy - e.xy * e.xy) - _LOG_TWO_PI


@inlined
def _inherit(beam: Beam, other: Beam, b: int, to: int, level: int) -> None:
    """Hypothesis `to` of the other beam becomes a copy of hypothesis b."""
    p, path, copy = beam.pairings[b], _path(beam, b), _path(other, to)
    other.pairings[to] = p
    for k in range(level):
        other.chosen[to, k] = beam.chosen[b, k]
    for q in range(p):
        copy.pairings[q] = path.pairings[q]
        for k in range(5):
            copy.pivots[q, k] = path.pivots[q, k]
        for r in range(2 * q):
            copy.w[q, r, 0], copy.w[q, r, 1] = path.w[q, r, 0], path.w[q, r, 1]


@compiled
def _first(beam: Beam, kept: int) -> Beam:
    paths = Path(beam.paths.pairings[:kept], beam.paths.pivots[:kept], beam.paths.w[:kept])
    return Beam(beam.chosen[:kept], beam.pairings[:kept], beam.score[:kept], paths)
