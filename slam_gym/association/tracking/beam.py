"""Beam search of the interpretation tree for the hypotheses of greatest density, level by level.

A hypothesis H scores log N(ν_H; 0, S_H) + Σ gain over its pairings + `unpaired` for every measurement decided `*`. log
N(ν_H; 0, S_H) is the sum of log N(e_c; 0, S_c|H) over its pairings, each given those before it. So each pairing adds a
term of its own, and hypotheses over the same measurements are comparable at every level.

Hypotheses with a common beginning share its nodes, and no factor is ever copied: a hypothesis is a row of node numbers.
Hypotheses with a common beginning are adjacent, so that a candidate is conditioned on every node once instead of once
per hypothesis. A pairing becomes a node only in a hypothesis that is kept.
"""

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled, inlined
from slam_gym.association import tree
from slam_gym.association.tree import Innovation, Pairings, Pivot
from slam_gym.types import Array, IntArray

_LOG_TWO_PI = math.log(2.0 * math.pi)
_SCRATCH = 0  # the node that holds w of the candidate under examination; hypotheses use the others
_INITIAL_NODES = 64  # initial capacity


class Joined(NamedTuple):
    """The pairings of all hypotheses, each a node: as it joined its hypothesis, conditioned on the pairings before it.

    A `tree.Node` keeps all candidates that may follow conditioned on it. This is wasted work where there are many
    paths. Here a single candidate is conditioned when it is examined, on the pairings of a path one by one.
    """

    pivots: Array  # (N, 5) fields of the `tree.Pivot` of each
    w: Array  # (N, 2P, 2) w of each, in hypotheses of at most P pairings; and of candidates under examination


class Beam(NamedTuple):
    """The hypotheses kept; those with a common beginning are adjacent."""

    score: Array  # (B,) including the fixed pairings, but not their gains
    pairings: IntArray  # (B,) number of pairings, including fixed ones
    made: IntArray  # (B, P) the pairings, in the order in which they joined
    nodes: IntArray  # (B, P) node of each
    joined: Joined


class _Room(NamedTuple):
    """The arrays of a search for B hypotheses, in two halves: one is read while the other receives the next level."""

    score: Array  # (2, B)
    pairings: IntArray  # (2, B)
    made: IntArray  # (2, B, P)
    nodes: IntArray  # (2, B, P)
    shared: IntArray  # (B,) number of first nodes that each hypothesis shares with the one before
    innovations: Array  # (P + 1, 5) innovation of a pairing after each node of a path
    offered: Array  # (B, 1 + c) scores with `*`, then with each pairing; −inf where not allowed or hopeless
    flat: Array  # (B (1 + c),) scores of the hypotheses that may be kept


_Level = tuple[_Room, Joined, int, int]
"""The state of a search at one level: its room, its nodes, the half of the room that holds the current hypotheses, and
their number."""


@compiled
def search(
    pairings: Pairings, levels: IntArray, gains: Array, unpaired: float, width: int, margin: float
) -> tuple[Beam, int, int, bool]:
    """The best hypotheses over the levels; the nodes and joint tests that it took; and whether the width excluded any.

    Arguments:
        levels: (l, 2) first and end index of the pairings of each level, in order of decision.
        gains: (c,) of each pairing.
        width: hypotheses kept at each level.
        margin: hypotheses that score this much less than the best are dropped.
    """
    room, joined, node_count = _begin(pairings, levels, width)
    now, kept, nodes, tests, cut = 0, 1, 0, 0, False
    for level in range(len(levels)):
        first, last = levels[level, 0], levels[level, 1]
        state = room, joined, now, kept
        best = _offer_star(room, now, kept, last - first, unpaired)
        for c in range(first, last):
            best, more = _offer_pairing(pairings, state, c, 1 + c - first, (gains[c], margin), best)
            tests += more
        joined, node_count, kept, full = _select(pairings, state, levels[level], best - margin, width, node_count)
        now, nodes, cut = 1 - now, nodes + kept, cut or full
    beam = Beam(
        room.score[now, :kept], room.pairings[now, :kept], room.made[now, :kept], room.nodes[now, :kept], joined
    )
    return beam, nodes, tests, cut


@compiled
def _begin(pairings: Pairings, levels: IntArray, width: int) -> tuple[_Room, Joined, int]:
    """Room for `width` hypotheses, or for as many as the levels can yield; one hypothesis, that of the fixed pairings,
    is entered. Also the nodes, and how many are in use."""
    depth = pairings.fixed + max(min(len(levels), len(pairings.covariance) // 2), 1) + 1
    most, count, node_count = 0, 1, _SCRATCH + 1
    for level in range(len(levels)):
        offers = 1 + levels[level, 1] - levels[level, 0]
        most, count = max(most, offers), min(count * offers, width)
    room = _Room(
        np.zeros((2, count)), np.zeros((2, count), np.int64), np.zeros((2, count, depth), np.int64),
        np.zeros((2, count, depth), np.int64), np.zeros(count, np.int64), np.empty((depth + 1, 5)),
        np.empty((count, 1 + most)), np.empty(count * (1 + most)),
    )  # fmt: skip
    N = max(_INITIAL_NODES, pairings.fixed + 2)
    joined = Joined(np.empty((N, 5)), np.empty((N, 2 * depth, 2)))
    for d in range(pairings.fixed):
        e = _join(pairings, joined, room.made[0, 0], room.nodes[0, 0], d, d, node_count)
        room.score[0, 0] += -0.5 * tree.squared(e) - 0.5 * math.log(e.xx * e.yy - e.xy * e.xy) - _LOG_TWO_PI
        room.pairings[0, 0], node_count = d + 1, node_count + 1
    return room, joined, node_count


@inlined
def _join(pairings: Pairings, joined: Joined, made: IntArray, nodes: IntArray, p: int, c: int, used: int) -> Innovation:
    """Append pairing c to the p pairings of a hypothesis, as node number `used`. Returns its innovation given these."""
    slots, e = pairings.slots, tree.innovation_of(pairings, c)
    for q in range(p):
        v = joined.pivots[nodes[q]]
        pivot = Pivot(slots[made[q]], v[0], v[1], v[2], v[3], v[4])
        e = tree.condition(pairings.covariance, joined.w, pivot, nodes[q], q, used, slots[c], e)
    pivot, v = tree.pivot_of(0, e), joined.pivots[used]
    v[0], v[1], v[2], v[3], v[4] = pivot.inverse_xx, pivot.yx, pivot.inverse_yy, pivot.u, pivot.v
    made[p], nodes[p] = c, used
    return e


@compiled
def _offer_star(room: _Room, now: int, kept: int, count: int, unpaired: float) -> float:
    """Begin a level of `count` pairings with the offer of `*` to every hypothesis. Returns the best score."""
    offered, score, pairings, nodes, shared = room.offered, room.score, room.pairings, room.nodes, room.shared
    best = -math.inf
    for b in range(kept):
        offered[b, 0], shared[b] = score[now, b] + unpaired, 0
        best = max(best, offered[b, 0])
        for k in range(1, 1 + count):
            offered[b, k] = -math.inf
        p = min(pairings[now, b], pairings[now, b - 1]) if b > 0 else 0
        while shared[b] < p and nodes[now, b, shared[b]] == nodes[now, b - 1, shared[b]]:
            shared[b] += 1
    return best


@compiled
def _offer_pairing(
    pairings: Pairings, level: _Level, c: int, place: int, price: tuple[float, float], best: float
) -> tuple[float, int]:
    """Score pairing c, at its `price` (gain and margin), after each hypothesis that allows it. Writes the scores to
    column `place` of the offers.

    Returns the best score, and the number of joint tests. Hypothesis b shares its first shared[b] nodes with the one
    before, and innovations[q] is that of c after q nodes: both are recomputed only from where the hypotheses differ.
    """
    room, joined, now, kept = level
    gain, margin = price
    slots, covariance, local, fixed = pairings.slots, pairings.covariance, pairings.local, pairings.fixed
    made, path, count, score, innovations = room.made, room.nodes, room.pairings, room.score, room.innovations
    shared, offered = room.shared, room.offered
    pivots, w, slot = joined.pivots, joined.w, slots[c]
    most = gain + greatest_log_density(pairings.noise[pairings.measured[c]])
    valid, tests = 0, 0
    tree.store(innovations, 0, tree.innovation_of(pairings, c))
    for b in range(kept):
        valid, p, previous = min(valid, shared[b]), count[now, b], score[now, b]
        if previous + most <= best - margin:
            continue
        if p > fixed and not tree.is_local(local, slots[made[now, b, fixed]], slot):
            continue
        e, free = tree.read(innovations, valid), True
        for q in range(p):
            free &= slots[made[now, b, q]] != slot
        if not free:
            continue
        for q in range(valid, p):
            d = path[now, b, q]
            pivot = Pivot(slots[made[now, b, q]], pivots[d, 0], pivots[d, 1], pivots[d, 2], pivots[d, 3], pivots[d, 4])
            e = tree.condition(covariance, w, pivot, d, q, _SCRATCH, slot, e)
            tree.store(innovations, q + 1, e)
        distance, valid, tests = tree.squared(e), p, tests + 1
        if previous + most - 0.5 * distance <= best - margin:  # rejects most, before the logarithm
            continue
        total = previous + gain - 0.5 * distance - 0.5 * math.log(e.xx * e.yy - e.xy * e.xy) - _LOG_TWO_PI
        if total > best - margin:
            offered[b, place], best = total, max(best, total)
    return best, tests


@compiled
def updated(P: Array, slots: IntArray, beam: Beam, positions: Array) -> tuple[Array, Array]:
    """Positions (b, k, 2) [m] and covariances (b, k, 2, 2) [m²] of features after an update with each hypothesis.

    P (2k, 2k) and `positions` (k, 2) are the predicted ones; `slots` (c,) are the features of the pairings. The
    noise-free measurement of a feature is conditioned on the path like any candidate. `_condition_all` does this for
    all features at once, with w stored by rows, so that the inner loops run along rows.
    """
    k, room = len(positions), beam.made.shape[1]
    made, path, pivots = beam.made, beam.nodes, beam.joined.pivots
    moved, remaining = np.empty((len(made), k, 2)), np.empty((len(made), k, 2, 2))
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
            remaining[b, j, 0, 0], remaining[b, j, 0, 1] = max(e[valid, 2, j], 0.0), e[valid, 3, j]
            remaining[b, j, 1, 0], remaining[b, j, 1, 1] = e[valid, 3, j], max(e[valid, 4, j], 0.0)
    return moved, remaining


@compiled
def _condition_all(P: Array, node_w: Array, pivots: Array, d: int, slot: int, q: int, w: Array, e: Array) -> None:
    """`tree.condition` for all features, by node d, the q-th of the path, of a pairing with the feature of `slot`."""
    xx, yx, yy, u, v = pivots[d, 0], pivots[d, 1], pivots[d, 2], pivots[d, 3], pivots[d, 4]
    x, y, row_x, row_y = w[2 * q], w[2 * q + 1], P[2 * slot], P[2 * slot + 1]
    for j in range(len(x)):
        x[j], y[j] = row_x[j], row_y[j]
    for r in range(2 * q):
        a, b, row = node_w[d, r, 0], node_w[d, r, 1], w[r]
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
def _select(
    pairings: Pairings, state: _Level, level: IntArray, least: float, width: int, used: int
) -> tuple[Joined, int, int, bool]:
    """Write the hypotheses of the next level: the best of those that score at least `least`. Each continues with `*`,
    then with the pairings of the `level`. Returns the nodes, how many are in use, the number of hypotheses, and whether
    the width excluded any."""
    room, joined, now, kept = state
    first, offers = level[0], 1 + level[1] - level[0]
    score, count, made, nodes, offered = room.score, room.pairings, room.made, room.nodes, room.offered
    scores, selected = room.flat, 0
    for b in range(kept):
        for k in range(offers):
            if offered[b, k] >= least and offered[b, k] > -math.inf:
                scores[selected] = offered[b, k]
                selected += 1
    full, next_half = selected > width, 1 - now
    threshold = np.partition(scores[:selected], selected - width)[selected - width] if full else least
    ties = width - np.count_nonzero(scores[:selected] > threshold)  # so many hypotheses that score just the threshold
    capacity, count_after, selected = len(joined.pivots), used + min(selected, width), 0
    if count_after > capacity:
        N, old = 2 * count_after, joined
        joined = Joined(np.empty((N, 5)), np.empty((N, old.w.shape[1], 2)))
        joined.pivots[:capacity], joined.w[:capacity] = old.pivots, old.w
    for b in range(kept):
        p = count[now, b]
        for k in range(offers):
            if selected == width or not offered[b, k] >= threshold or offered[b, k] == -math.inf:
                continue
            if full and offered[b, k] == threshold:
                if ties == 0:
                    continue
                ties -= 1
            for q in range(p):
                made[next_half, selected, q], nodes[next_half, selected, q] = made[now, b, q], nodes[now, b, q]
            score[next_half, selected], count[next_half, selected] = offered[b, k], p
            if k > 0:
                _join(pairings, joined, made[next_half, selected], nodes[next_half, selected], p, first + k - 1, used)
                count[next_half, selected], used = p + 1, used + 1
            selected += 1
    return joined, used, selected, full


@inlined
def greatest_log_density(noise: Array) -> float:
    """Upper bound of log N(e; 0, S) of a measurement with `noise` (2, 2): S is at least the noise."""
    determinant = noise[0, 0] * noise[1, 1] - noise[0, 1] * noise[0, 1]
    return -0.5 * math.log(determinant) - _LOG_TWO_PI if determinant > 0.0 else math.inf
