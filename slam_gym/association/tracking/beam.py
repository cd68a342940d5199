"""Beam search of the interpretation tree for the hypotheses of greatest density, level by level.

A hypothesis H scores log N(ν_H; 0, S_H) + Σ gain over its pairings + `unpaired` for every measurement decided `*`.
log N(ν_H; 0, S_H) is the sum of log N(e_c; 0, S_c|H) over its pairings, each given those before it: each pairing adds a
term of its own, and hypotheses over the same measurements compare at every level.

Hypotheses that begin alike share the nodes of their beginnings, and no factor is ever copied: a hypothesis is a row of
node numbers. Whatever shares a beginning stands together, so that a candidate is conditioned on every node once, not
once for every hypothesis.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled, inlined
from slam_gym.association.tracking.path import Path, append
from slam_gym.association.tree import (
    Innovation,
    Pairings,
    Pivot,
    condition,
    innovation_of,
    may_follow,
    read,
    squared,
    store,
)
from slam_gym.types import Array, IntArray

_LOG_TWO_PI = math.log(2.0 * math.pi)
_LOOKED_AT = 0  # the node that holds w of what is looked at; hypotheses have the others
_NODES = 64  # room for nodes to begin with


class Prices(NamedTuple):
    """What hypotheses score beside log N(ν_H; 0, S_H), and which are kept."""

    gains: Array  # (c,) for each pairing
    unpaired: float  # for a measurement decided `*`
    width: int  # hypotheses kept at each level
    margin: float  # none is kept that scores so much less than the best


class Beam(NamedTuple):
    """Hypotheses kept, those that begin alike together."""

    score: Array  # (B,) pairings given included, but for their gains
    pairings: IntArray  # (B,) number of pairings, those given included
    made: IntArray  # (B, P) the pairings, in the order in which they joined
    nodes: IntArray  # (B, P) node of each
    joined: Path  # by node: each pairing as it joined those before it


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


class _Trail(NamedTuple):
    """What is looked at, conditioned along one hypothesis after the other: anew only from where they part."""

    nodes: IntArray  # (P,) of the last hypothesis
    innovations: Array  # (P + 1, 5) by the number of nodes that it is conditioned on


@compiled
def search(pairings: Pairings, levels: IntArray, prices: Prices) -> BeamSearch:
    """The best hypotheses over levels whose pairings begin and end at `levels` (l, 2), in the order of decision."""
    room = pairings.given + max(min(len(levels), len(pairings.covariance) // 2), 1) + 1
    beam, used = _begin(pairings, room)
    trail, nodes, tests, cut = _trail(room), 0, 0, False
    for level in range(len(levels)):
        first, last = levels[level, 0], levels[level, 1]
        offered = np.full((len(beam.score), 1 + last - first), -math.inf)
        joins = np.zeros(offered.shape, np.int64)
        offered[:, 0] = beam.score + prices.unpaired
        best = offered[:, 0].max()
        for c in range(first, last):
            before, beam = -1, _with_room(beam, used + len(beam.score))
            gain, start = prices.gains[c], innovation_of(pairings, c)
            most = gain + _greatest_log_density(pairings, c)
            for b in range(len(beam.score)):
                hopeless = beam.score[b] + most <= best - prices.margin
                if hopeless or not may_follow(pairings, beam.made[b], beam.pairings[b], c):
                    continue
                e = _along(pairings, beam, trail, before, b, pairings.slots[c], start)
                score, before, tests = beam.score[b] + gain + _log_density(e), b, tests + 1
                if score > best - prices.margin:
                    offered[b, 1 + c - first], joins[b, 1 + c - first], best = score, used, max(best, score)
                    _join(beam, used, b, c, e)
                    used += 1
        floor, full = _floor(offered, best - prices.margin, prices.width)
        beam, cut = _next(beam, first, offered, joins, floor, prices.width), cut or full
        nodes += len(beam.score)
    return BeamSearch(beam, nodes, tests, cut)


@compiled
def updated(pairings: Pairings, beam: Beam, positions: Array) -> Moved:
    """Features after an update with each hypothesis of the beam.

    positions (k, 2) are those predicted, the covariance of `pairings` (2k, 2k); slot s is feature s. What a feature
    would be measured at, free of noise, is conditioned on the path like any candidate.
    """
    hypotheses, k, P = len(beam.score), len(positions), pairings.covariance
    moved, left = np.empty((hypotheses, k, 2)), np.empty((hypotheses, k, 2, 2))
    trail = _trail(beam.nodes.shape[1])
    for j in range(k):
        s = 2 * j
        start = Innovation(0.0, 0.0, P[s, s], P[s, s + 1], P[s + 1, s + 1])
        for b in range(hypotheses):
            e, out = _along(pairings, beam, trail, b - 1, b, j, start), left[b, j]
            moved[b, j, 0], moved[b, j, 1] = positions[j, 0] - e.x, positions[j, 1] - e.y
            out[0, 0], out[0, 1], out[1, 0], out[1, 1] = max(e.xx, 0.0), e.xy, e.xy, max(e.yy, 0.0)
    return Moved(moved, left)


@compiled
def _begin(pairings: Pairings, room: int) -> tuple[Beam, int]:
    """The hypothesis of the given pairings, and the number of nodes in use."""
    g, N = pairings.given, max(_NODES, pairings.given + 2)
    joined = Path(np.empty(N, np.int64), np.empty((N, 5)), np.empty((N, 2 * room, 2)))
    made, nodes = np.zeros((1, room), np.int64), np.zeros((1, room), np.int64)
    beam, trail = Beam(np.zeros(1), np.zeros(1, np.int64), made, nodes, joined), _trail(room)
    for d in range(g):
        e = _along(pairings, beam, trail, -1, 0, pairings.slots[d], innovation_of(pairings, d))
        _join(beam, 1 + d, 0, d, e)
        beam.made[0, d], beam.nodes[0, d], beam.pairings[0] = d, 1 + d, d + 1
        beam.score[0] += _log_density(e)
    return beam, 1 + g


@compiled
def _trail(room: int) -> _Trail:
    return _Trail(np.empty(room, np.int64), np.empty((room + 1, 5)))


@inlined
def _along(
    pairings: Pairings, beam: Beam, trail: _Trail, before: int, b: int, slot: int, start: Innovation
) -> Innovation:
    """Innovation of what depends on a feature, `start` given nothing, after the pairings of hypothesis b.

    Hypothesis `before` is the one that the same was asked of last; −1: none was.
    """
    p, w, shared = beam.pairings[b], beam.joined.w, 0
    if before >= 0:
        while shared < min(p, beam.pairings[before]) and trail.nodes[shared] == beam.nodes[b, shared]:
            shared += 1
    else:
        store(trail.innovations, 0, start)
    e = read(trail.innovations, shared)
    for q in range(shared, p):
        node = beam.nodes[b, q]
        v = beam.joined.pivots[node]
        pivot = Pivot(pairings.slots[beam.made[b, q]], v[0], v[1], v[2], v[3], v[4])
        e = condition(pairings.covariance, w, pivot, node, q, _LOOKED_AT, slot, e)
        store(trail.innovations, q + 1, e)
        trail.nodes[q] = node
    return e


@compiled
def _with_room(beam: Beam, nodes: int) -> Beam:
    """The beam with room for so many nodes."""
    joined, held = beam.joined, len(beam.joined.pairings)
    if nodes <= held:
        return beam
    count = 2 * nodes
    more = Path(np.empty(count, np.int64), np.empty((count, 5)), np.empty((count, joined.w.shape[1], 2)))
    more.pairings[:held], more.pivots[:held], more.w[:held] = joined.pairings, joined.pivots, joined.w
    return Beam(beam.score, beam.pairings, beam.made, beam.nodes, more)


@inlined
def _join(beam: Beam, node: int, b: int, c: int, e: Innovation) -> None:
    """Pairing c, just looked at with innovation e after hypothesis b, becomes a node."""
    w = beam.joined.w
    for r in range(2 * beam.pairings[b]):
        w[node, r, 0], w[node, r, 1] = w[_LOOKED_AT, r, 0], w[_LOOKED_AT, r, 1]
    append(beam.joined, node, c, e)


@compiled
def _floor(offered: Array, least: float, width: int) -> tuple[float, bool]:
    """The least score to be kept, and whether the width has turned hypotheses away."""
    scores, count = np.empty(offered.size), 0
    for score in offered.ravel():
        if score >= least and score > -math.inf:
            scores[count] = score
            count += 1
    if count <= width:
        return least, False
    return np.sort(scores[:count])[count - width], True


@compiled
def _next(beam: Beam, first: int, offered: Array, joins: IntArray, floor: float, width: int) -> Beam:
    """The hypotheses of the next level: each that scores the floor with `*`, then with the pairings from `first` on."""
    kept, room = 0, beam.made.shape[1]
    score, count = np.empty(width), np.empty(width, np.int64)
    made, nodes = np.empty((width, room), np.int64), np.empty((width, room), np.int64)
    for b in range(len(offered)):
        p = beam.pairings[b]
        for k in range(offered.shape[1]):
            if kept == width or not offered[b, k] >= floor or offered[b, k] == -math.inf:
                continue
            for q in range(p):
                made[kept, q], nodes[kept, q] = beam.made[b, q], beam.nodes[b, q]
            score[kept], count[kept] = offered[b, k], p
            if k > 0:
                made[kept, p], nodes[kept, p], count[kept] = first + k - 1, joins[b, k], p + 1
            kept += 1
    return Beam(score[:kept], count[:kept], made[:kept], nodes[:kept], beam.joined)


@inlined
def _log_density(e: Innovation) -> float:
    """log N(e; 0, S); −inf where S is singular."""
    distance = squared(e)
    if distance == math.inf:
        return -math.inf
    return -0.5 * distance - 0.5 * math.log(e.xx * e.yy - e.xy * e.xy) - _LOG_TWO_PI


@inlined
def _greatest_log_density(pairings: Pairings, c: int) -> float:
    """What log N(e; 0, S) of a pairing never exceeds, whatever it follows: S is at least the noise."""
    noise = pairings.noise[pairings.measured[c]]
    determinant = noise[0, 0] * noise[1, 1] - noise[0, 1] * noise[0, 1]
    return -0.5 * math.log(determinant) - _LOG_TWO_PI if determinant > 0.0 else math.inf
