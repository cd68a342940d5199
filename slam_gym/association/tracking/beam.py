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
    PairingArrays,
    Pairings,
    Pivot,
    condition,
    innovation_of,
    is_local,
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


BeamArrays = tuple[Array, IntArray, IntArray, IntArray, IntArray, Array, Array]
"""All arrays of a `Beam`, as it comes to Python: a named tuple of compiled code takes as long as three arrays."""


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


class _Offer(NamedTuple):
    """What may become of the hypotheses at a level."""

    scores: Array  # (B, 1 + c) with `*`, then with each pairing on offer; −inf where it may not be or is hopeless
    nodes: IntArray  # (B, 1 + c) of those pairings


@compiled
def search(pairings: Pairings, levels: IntArray, prices: Prices) -> BeamSearch:
    """The best hypotheses over levels whose pairings begin and end at `levels` (l, 2), in the order of decision."""
    room = pairings.given + max(min(len(levels), len(pairings.covariance) // 2), 1) + 1
    beam, used = _begin(pairings, room)
    along, nodes, tests, cut = np.empty((room + 1, 5)), 0, 0, False
    for level in range(len(levels)):
        first, last = levels[level, 0], levels[level, 1]
        offer = _Offer(
            np.full((len(beam.score), 1 + last - first), -math.inf),
            np.zeros((len(beam.score), 1 + last - first), np.int64),
        )
        offer.scores[:, 0] = beam.score + prices.unpaired
        best, together = offer.scores[:, 0].max(), _shared(beam)
        for c in range(first, last):
            beam = _with_room(beam, used + len(beam.score))
            scores, joins = offer.scores[:, 1 + c - first], offer.nodes[:, 1 + c - first]
            price = (prices.gains[c], prices.margin)
            best, used, more = _pair(pairings, beam, together, along, c, price, best, scores, joins, used)
            tests += more
        floor, full = _floor(offer.scores, best - prices.margin, prices.width)
        beam, cut = _next(beam, first, offer, floor, prices.width), cut or full
        nodes += len(beam.score)
    return BeamSearch(beam, nodes, tests, cut)


@compiled
def _pair(
    pairings: Pairings,
    beam: Beam,
    together: IntArray,
    along: Array,
    c: int,
    price: tuple[float, float],
    best: float,
    scores: Array,
    nodes: IntArray,
    used: int,
) -> tuple[float, int, int]:
    """Enter scores (B,) and nodes (B,) of pairing c, at its gain and the margin, after every hypothesis that allows it.

    Returns the best score, the nodes in use, and how many were tested. Hypothesis b has its first together[b] nodes in
    common with the one before, and along[q] is the innovation of c after q nodes: both are worked out anew only from
    where the hypotheses part.
    """
    gain, margin = price
    slots, covariance, local, given = pairings.slots, pairings.covariance, pairings.local, pairings.given
    made, path, count, score = beam.made, beam.nodes, beam.pairings, beam.score
    pivots, w, slot = beam.joined.pivots, beam.joined.w, slots[c]
    most = gain + greatest_log_density(pairings.noise[pairings.measured[c]])
    valid, tests = 0, 0
    store(along, 0, innovation_of(pairings, c))
    for b in range(len(score)):
        valid, p = min(valid, together[b]), count[b]
        if score[b] + most <= best - margin or (p > given and not is_local(local, slots[made[b, given]], slot)):
            continue
        e, free = read(along, valid), True
        for q in range(p):
            free &= slots[made[b, q]] != slot
        if not free:
            continue
        for q in range(valid, p):
            d = path[b, q]
            pivot = Pivot(slots[made[b, q]], pivots[d, 0], pivots[d, 1], pivots[d, 2], pivots[d, 3], pivots[d, 4])
            e = condition(covariance, w, pivot, d, q, _LOOKED_AT, slot, e)
            store(along, q + 1, e)
        distance, valid, tests = squared(e), p, tests + 1
        if score[b] + most - 0.5 * distance <= best - margin:  # most end here, before the logarithm
            continue
        total = score[b] + gain - 0.5 * distance - 0.5 * math.log(e.xx * e.yy - e.xy * e.xy) - _LOG_TWO_PI
        if total > best - margin:
            scores[b], nodes[b], best = total, used, max(best, total)
            _join(beam.joined, used, p, c, e)
            used += 1
    return best, used, tests


@compiled
def updated(arrays: PairingArrays, beam: Beam, positions: Array) -> tuple[Array, Array]:
    """`Moved`: features after an update with each hypothesis of the beam.

    positions (k, 2) are those predicted, the covariance of `pairings` (2k, 2k); slot s is feature s. What a feature
    would be measured at, free of noise, is conditioned on the path like any candidate.
    """
    pairings, k, together = Pairings(*arrays), len(positions), _shared(beam)
    P, slots, made, path = pairings.covariance, pairings.slots, beam.made, beam.nodes
    pivots, w = beam.joined.pivots, beam.joined.w
    moved, left = np.empty((len(made), k, 2)), np.empty((len(made), k, 2, 2))
    along = np.empty((made.shape[1] + 1, 5))
    for j in range(k):
        s, valid = 2 * j, 0
        store(along, 0, Innovation(0.0, 0.0, P[s, s], P[s, s + 1], P[s + 1, s + 1]))
        for b in range(len(made)):
            valid = min(valid, together[b])
            e = read(along, valid)
            for q in range(valid, beam.pairings[b]):
                d = path[b, q]
                pivot = Pivot(slots[made[b, q]], pivots[d, 0], pivots[d, 1], pivots[d, 2], pivots[d, 3], pivots[d, 4])
                e = condition(P, w, pivot, d, q, _LOOKED_AT, j, e)
                store(along, q + 1, e)
            valid = beam.pairings[b]
            moved[b, j, 0], moved[b, j, 1] = positions[j, 0] - e.x, positions[j, 1] - e.y
            left[b, j, 0, 0], left[b, j, 0, 1] = max(e.xx, 0.0), e.xy
            left[b, j, 1, 0], left[b, j, 1, 1] = e.xy, max(e.yy, 0.0)
    return moved, left


@inlined
def plainly(beam: Beam) -> BeamArrays:
    """Its arrays."""
    joined = beam.joined
    return beam.score, beam.pairings, beam.made, beam.nodes, joined.pairings, joined.pivots, joined.w


@compiled
def _begin(pairings: Pairings, room: int) -> tuple[Beam, int]:
    """The hypothesis of the given pairings, and the number of nodes in use."""
    g, N = pairings.given, max(_NODES, pairings.given + 2)
    joined = Path(np.empty(N, np.int64), np.empty((N, 5)), np.empty((N, 2 * room, 2)))
    beam = Beam(
        np.zeros(1), np.zeros(1, np.int64), np.zeros((1, room), np.int64), np.zeros((1, room), np.int64), joined
    )
    offer, together, used = _Offer(np.zeros((1, 1)), np.zeros((1, 1), np.int64)), np.zeros(1, np.int64), _LOOKED_AT + 1
    along = np.empty((room + 1, 5))
    scores, nodes = offer.scores[:, 0], offer.nodes[:, 0]
    for d in range(g):
        scores[0] = -math.inf
        _, used, _ = _pair(pairings, beam, together, along, d, (0.0, math.inf), -math.inf, scores, nodes, used)
        beam.made[0, d], beam.nodes[0, d], beam.pairings[0], beam.score[0] = d, nodes[0], d + 1, scores[0]
    return beam, used


@compiled
def _shared(beam: Beam) -> IntArray:
    """How many of its first nodes each hypothesis has in common with the one before, (B,)."""
    together = np.zeros(len(beam.score), np.int64)
    for b in range(1, len(beam.score)):
        p = min(beam.pairings[b], beam.pairings[b - 1])
        while together[b] < p and beam.nodes[b, together[b]] == beam.nodes[b - 1, together[b]]:
            together[b] += 1
    return together


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
def _join(joined: Path, node: int, p: int, c: int, e: Innovation) -> None:
    """Pairing c, just looked at with innovation e after p others, becomes a node."""
    w = joined.w
    for r in range(2 * p):
        w[node, r, 0], w[node, r, 1] = w[_LOOKED_AT, r, 0], w[_LOOKED_AT, r, 1]
    append(joined, node, c, e)


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
    return np.partition(scores[:count], count - width)[count - width], True


@compiled
def _next(beam: Beam, first: int, offer: _Offer, floor: float, width: int) -> Beam:
    """The hypotheses of the next level: each that scores the floor with `*`, then with the pairings from `first` on."""
    kept, room, offered = 0, beam.made.shape[1], offer.scores
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
                made[kept, p], nodes[kept, p], count[kept] = first + k - 1, offer.nodes[b, k], p + 1
            kept += 1
    return Beam(score[:kept], count[:kept], made[:kept], nodes[:kept], beam.joined)


@inlined
def greatest_log_density(noise: Array) -> float:
    """What log N(e; 0, S) of a measurement with `noise` (2, 2) never exceeds, whatever it is of: S is at least that."""
    determinant = noise[0, 0] * noise[1, 1] - noise[0, 1] * noise[0, 1]
    return -0.5 * math.log(determinant) - _LOG_TWO_PI if determinant > 0.0 else math.inf
