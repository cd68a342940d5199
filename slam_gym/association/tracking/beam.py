"""Beam search of the interpretation tree for the hypotheses of greatest density, level by level.

A hypothesis H scores log N(ν_H; 0, S_H) + Σ gain over its pairings + `unpaired` for every measurement decided `*`.
log N(ν_H; 0, S_H) is the sum of log N(e_c; 0, S_c|H) over its pairings, each given those before it: each pairing adds a
term of its own, and hypotheses over the same measurements compare at every level.

Hypotheses that begin alike share the nodes of their beginnings, and no factor is ever copied: a hypothesis is a row of
node numbers. Whatever shares a beginning stands together, so that a candidate is conditioned on every node once, not
once for every hypothesis. A pairing becomes a node only in a hypothesis that is kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled, inlined
from slam_gym.association.tracking.path import Path, append
from slam_gym.association.tree import (
    Innovation,
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


class _Room(NamedTuple):
    """Where a search works: room for B hypotheses, of which levels write the next ones beside their own."""

    score: Array  # (2, B)
    pairings: IntArray  # (2, B)
    made: IntArray  # (2, B, P)
    nodes: IntArray  # (2, B, P)
    together: IntArray  # (B,) how many of its first nodes each has in common with the one before
    along: Array  # (P + 1, 5) innovations of a pairing along a path
    offered: Array  # (B, 1 + c) scores with `*`, then with each pairing; −inf where it may not be or is hopeless
    flat: Array  # (B (1 + c),) scores that may be kept


class _Level(NamedTuple):
    """Where a search stands."""

    room: _Room
    joined: Path
    now: int  # which of the two halves of the room holds the hypotheses
    kept: int  # their number


@compiled
def search(pairings: Pairings, levels: IntArray, prices: Prices) -> tuple[Beam, int, int, bool]:
    """The best hypotheses over levels whose pairings begin and end at `levels` (l, 2), in the order of decision; the
    nodes and the joint tests that it took; and whether the width turned hypotheses away."""
    room, joined, used = _begin(pairings, levels, prices.width)
    now, kept, nodes, tests, cut = 0, 1, 0, 0, False
    for level in range(len(levels)):
        first, last = levels[level, 0], levels[level, 1]
        here = _Level(room, joined, now, kept)
        best = _offer_none(room, now, kept, last - first, prices.unpaired)
        for c in range(first, last):
            price = prices.gains[c], prices.margin
            best, more = _offer_pairing(pairings, here, c, 1 + c - first, price, best)
            tests += more
        least = best - prices.margin
        joined, used, kept, full = _select(pairings, here, levels[level], least, prices.width, used)
        now, nodes, cut = 1 - now, nodes + kept, cut or full
    beam = Beam(
        room.score[now, :kept], room.pairings[now, :kept], room.made[now, :kept], room.nodes[now, :kept], joined
    )
    return beam, nodes, tests, cut


@compiled
def _begin(pairings: Pairings, levels: IntArray, width: int) -> tuple[_Room, Path, int]:
    """Room for `width` hypotheses, or fewer where the levels have no more to offer, with that of the given pairings
    entered; and the number of nodes in use."""
    place = pairings.fixed + max(min(len(levels), len(pairings.covariance) // 2), 1) + 1
    most, count, used = 0, 1, _LOOKED_AT + 1
    for level in range(len(levels)):
        offers = 1 + levels[level, 1] - levels[level, 0]
        most, count = max(most, offers), min(count * offers, width)
    room = _Room(
        np.zeros((2, count)), np.zeros((2, count), np.int64), np.zeros((2, count, place), np.int64),
        np.zeros((2, count, place), np.int64), np.zeros(count, np.int64), np.empty((place + 1, 5)),
        np.empty((count, 1 + most)), np.empty(count * (1 + most)),
    )  # fmt: skip
    N = max(_NODES, pairings.fixed + 2)
    joined = Path(np.empty(N, np.int64), np.empty((N, 5)), np.empty((N, 2 * place, 2)))
    for d in range(pairings.fixed):
        e = _join(pairings, joined, room.made[0, 0], room.nodes[0, 0], d, d, used)
        room.score[0, 0] += -0.5 * squared(e) - 0.5 * math.log(e.xx * e.yy - e.xy * e.xy) - _LOG_TWO_PI
        room.pairings[0, 0], used = d + 1, used + 1
    return room, joined, used


@inlined
def _join(pairings: Pairings, joined: Path, made: IntArray, nodes: IntArray, p: int, c: int, used: int) -> Innovation:
    """Pairing c joins the p pairings of a hypothesis, as node number `used`. Its innovation after those."""
    pivots, slots, e = joined.pivots, pairings.slots, innovation_of(pairings, c)
    for q in range(p):
        d = nodes[q]
        pivot = Pivot(slots[made[q]], pivots[d, 0], pivots[d, 1], pivots[d, 2], pivots[d, 3], pivots[d, 4])
        e = condition(pairings.covariance, joined.w, pivot, d, q, used, slots[c], e)
    append(joined, used, c, e)
    made[p], nodes[p] = c, used
    return e


@compiled
def _offer_none(room: _Room, now: int, kept: int, count: int, unpaired: float) -> float:
    """Begin a level of `count` pairings: every hypothesis may go on with `*`. The best score so far."""
    offered, score, pairings, nodes, together = room.offered, room.score, room.pairings, room.nodes, room.together
    best = -math.inf
    for b in range(kept):
        offered[b, 0] = score[now, b] + unpaired
        best = max(best, offered[b, 0])
        for k in range(1, 1 + count):
            offered[b, k] = -math.inf
        together[b] = 0
        p = min(pairings[now, b], pairings[now, b - 1]) if b > 0 else 0
        while together[b] < p and nodes[now, b, together[b]] == nodes[now, b - 1, together[b]]:
            together[b] += 1
    return best


@compiled
def _offer_pairing(
    pairings: Pairings, level: _Level, c: int, place: int, price: tuple[float, float], best: float
) -> tuple[float, int]:
    """Enter the scores of pairing c, at its `price` (gain and margin), after each hypothesis that allows it, as offers
    number `place`.

    Returns the best score, and how many were tested. Hypothesis b has its first together[b] nodes in
    common with the one before, and along[q] is the innovation of c after q nodes: both are worked out anew only from
    where the hypotheses part.
    """
    room, joined, now, kept = level
    gain, margin = price
    slots, covariance, local, given = pairings.slots, pairings.covariance, pairings.local, pairings.fixed
    made, path, count, score, along = room.made, room.nodes, room.pairings, room.score, room.along
    together, offered = room.together, room.offered
    pivots, w, slot = joined.pivots, joined.w, slots[c]
    most = gain + greatest_log_density(pairings.noise[pairings.measured[c]])
    valid, tests = 0, 0
    store(along, 0, innovation_of(pairings, c))
    for b in range(kept):
        valid, p = min(valid, together[b]), count[now, b]
        before = score[now, b]
        if before + most <= best - margin or (p > given and not is_local(local, slots[made[now, b, given]], slot)):
            continue
        e, free = read(along, valid), True
        for q in range(p):
            free &= slots[made[now, b, q]] != slot
        if not free:
            continue
        for q in range(valid, p):
            d = path[now, b, q]
            pivot = Pivot(slots[made[now, b, q]], pivots[d, 0], pivots[d, 1], pivots[d, 2], pivots[d, 3], pivots[d, 4])
            e = condition(covariance, w, pivot, d, q, _LOOKED_AT, slot, e)
            store(along, q + 1, e)
        distance, valid, tests = squared(e), p, tests + 1
        if before + most - 0.5 * distance <= best - margin:  # most end here, before the logarithm
            continue
        total = before + gain - 0.5 * distance - 0.5 * math.log(e.xx * e.yy - e.xy * e.xy) - _LOG_TWO_PI
        if total > best - margin:
            offered[b, place], best = total, max(best, total)
    return best, tests


@compiled
def updated(pairings: Pairings, beam: Beam, positions: Array) -> tuple[Array, Array]:
    """Positions (b, k, 2) [m] and covariances (b, k, 2, 2) [m²] of features after an update with each hypothesis.

    positions (k, 2) are those predicted, the covariance of `pairings` (2k, 2k); slot s is feature s. What a feature
    would be measured at, free of noise, is conditioned on the path like any candidate: here all features at once, each
    by what `tree.condition` does, so that w stands by rows and the loops over it run along them.
    """
    k, room = len(positions), beam.made.shape[1]
    P, slots, made, path, pivots = pairings.covariance, pairings.slots, beam.made, beam.nodes, beam.joined.pivots
    moved, left = np.empty((len(made), k, 2)), np.empty((len(made), k, 2, 2))
    w, e = np.empty((2 * room, 2 * k)), np.empty((room + 1, 5, k))
    for j in range(k):
        e[0, 0, j], e[0, 1, j] = 0.0, 0.0
        e[0, 2, j], e[0, 3, j], e[0, 4, j] = P[2 * j, 2 * j], P[2 * j, 2 * j + 1], P[2 * j + 1, 2 * j + 1]
    valid = 0
    for b in range(len(made)):
        shared = 0
        while b > 0 and shared < min(valid, beam.pairings[b]) and path[b, shared] == path[b - 1, shared]:
            shared += 1
        for q in range(shared, beam.pairings[b]):
            _condition_all(P, beam.joined.w, pivots, path[b, q], slots[made[b, q]], q, w, e)
        valid = beam.pairings[b]
        for j in range(k):
            moved[b, j, 0], moved[b, j, 1] = positions[j, 0] - e[valid, 0, j], positions[j, 1] - e[valid, 1, j]
            left[b, j, 0, 0], left[b, j, 0, 1] = max(e[valid, 2, j], 0.0), e[valid, 3, j]
            left[b, j, 1, 0], left[b, j, 1, 1] = e[valid, 3, j], max(e[valid, 4, j], 0.0)
    return moved, left


@compiled
def _condition_all(P: Array, known: Array, pivots: Array, d: int, slot: int, q: int, w: Array, e: Array) -> None:
    """`tree.condition` for all features by node d, the q-th of the path, of a pairing with the feature in a slot."""
    xx, yx, yy, u, v = pivots[d, 0], pivots[d, 1], pivots[d, 2], pivots[d, 3], pivots[d, 4]
    x, y, top, low = w[2 * q], w[2 * q + 1], P[2 * slot], P[2 * slot + 1]
    for j in range(len(x)):
        x[j], y[j] = top[j], low[j]
    for r in range(2 * q):
        a, b, row = known[d, r, 0], known[d, r, 1], w[r]
        for j in range(len(x)):
            x[j] -= a * row[j]
            y[j] -= b * row[j]
    for j in range(len(x)):
        x[j] = x[j] * xx
        y[j] = (y[j] - yx * x[j]) * yy
    before, after = e[q], e[q + 1]
    for j in range(after.shape[1]):
        s00, s01, s10, s11 = x[2 * j], x[2 * j + 1], y[2 * j], y[2 * j + 1]
        after[0, j] = before[0, j] - s00 * u - s10 * v
        after[1, j] = before[1, j] - s01 * u - s11 * v
        after[2, j] = before[2, j] - s00 * s00 - s10 * s10
        after[3, j] = before[3, j] - s00 * s01 - s10 * s11
        after[4, j] = before[4, j] - s01 * s01 - s11 * s11


@compiled
def _with_room(joined: Path, nodes: int) -> Path:
    """The path with room for so many nodes."""
    held = len(joined.pairings)
    if nodes <= held:
        return joined
    count = 2 * nodes
    more = Path(np.empty(count, np.int64), np.empty((count, 5)), np.empty((count, joined.w.shape[1], 2)))
    more.pairings[:held], more.pivots[:held], more.w[:held] = joined.pairings, joined.pivots, joined.w
    return more


@compiled
def _select(
    pairings: Pairings, here: _Level, level: IntArray, least: float, width: int, used: int
) -> tuple[Path, int, int, bool]:
    """Enter the hypotheses of the next level, those that score best of what scores `least`: each goes on with `*`, then
    with the pairings of the `level`. Returns the nodes, how many are in use, the number of hypotheses, and whether the
    width has turned any away."""
    room, joined, now, kept = here
    offered, scores, first, last = room.offered, room.flat, level[0], level[1]
    score, count, made, nodes = room.score, room.pairings, room.made, room.nodes
    found = 0
    for b in range(kept):
        for k in range(1 + last - first):
            if offered[b, k] >= least and offered[b, k] > -math.inf:
                scores[found] = offered[b, k]
                found += 1
    full, then = found > width, 1 - now
    floor = np.partition(scores[:found], found - width)[found - width] if full else least
    joined, found = _with_room(joined, used + min(found, width)), 0
    for b in range(kept):
        p = count[now, b]
        for k in range(1 + last - first):
            if found == width or not offered[b, k] >= floor or offered[b, k] == -math.inf:
                continue
            for q in range(p):
                made[then, found, q], nodes[then, found, q] = made[now, b, q], nodes[now, b, q]
            score[then, found], count[then, found] = offered[b, k], p
            if k > 0:
                _join(pairings, joined, made[then, found], nodes[then, found], p, first + k - 1, used)
                count[then, found], used = p + 1, used + 1
            found += 1
    return joined, used, found, full


@inlined
def greatest_log_density(noise: Array) -> float:
    """What log N(e; 0, S) of a measurement with `noise` (2, 2) never exceeds, whatever it is of: S is at least that."""
    determinant = noise[0, 0] * noise[1, 1] - noise[0, 1] * noise[0, 1]
    return -0.5 * math.log(determinant) - _LOG_TWO_PI if determinant > 0.0 else math.inf
