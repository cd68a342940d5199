"""A path of the tree on which candidates are conditioned one at a time, when they are examined.

A `tree.Node` keeps all candidates that may follow conditioned on it. This is wasted work where there are many paths, as
in a beam, or where each path is used once, as after every draw of 1-point RANSAC. Here a single candidate is
conditioned on the pairings of the path one by one, by the same `tree.condition`, and no w is copied for each
hypothesis.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled, inlined
from slam_gym.association.tree import (
    Innovation,
    Pairings,
    Pivot,
    condition,
    innovation_of,
    is_local,
    pivot_of,
    squared,
)
from slam_gym.types import Array, IntArray


class Path(NamedTuple):
    """The pairings of a path, with room for more."""

    pairings: IntArray  # (P,) the pairings, first to last
    pivots: Array  # (P, 5) fields of the `tree.Pivot` of each
    w: Array  # (P, 2P, 2) w of each pairing as it joined; then that of the candidate examined last


@compiled
def path_of(pairings: Pairings, room: int) -> Path:
    """The path of the fixed pairings, with room for `room` more."""
    P = pairings.fixed + room
    path = Path(np.zeros(P, np.int64), np.empty((P, 5)), np.empty((P, 2 * P, 2)))
    for d in range(pairings.fixed):
        append(path, d, d, follow(pairings, path, d, d))
    return path


@inlined
def follow(pairings: Pairings, path: Path, p: int, c: int) -> Innovation:
    """Innovation of pairing c after the first p pairings of a path. The w that follows theirs becomes that of c."""
    slot, e = pairings.slots[c], innovation_of(pairings, c)
    for q in range(p):
        v = path.pivots[q]
        pivot = Pivot(pairings.slots[path.pairings[q]], v[0], v[1], v[2], v[3], v[4])
        e = condition(pairings.covariance, path.w, pivot, q, q, p, slot, e)
    return e


@inlined
def append(path: Path, p: int, c: int, e: Innovation) -> None:
    """Append pairing c, whose innovation e was just computed by `follow`, to the p pairings of a path."""
    pivot, v = pivot_of(0, e), path.pivots[p]
    path.pairings[p] = c
    v[0], v[1], v[2], v[3], v[4] = pivot.inverse_xx, pivot.yx, pivot.inverse_yy, pivot.u, pivot.v


@compiled
def distances_with(pairings: Pairings, path: Path, anchor: int, out: Array) -> None:
    """D² (c,) of each candidate after an update with the fixed pairings and the anchor; inf where it may not follow.

    For the anchor itself it is D² after an update with the fixed pairings only.
    """
    p, slots, measured = pairings.fixed, pairings.slots, pairings.measured
    e = follow(pairings, path, p, anchor)
    of_anchor = squared(e)
    if of_anchor < math.inf:
        append(path, p, anchor, e)
    for c in range(len(slots)):
        out[c] = math.inf
        if c < p or of_anchor == math.inf or measured[c] == measured[anchor] or slots[c] == slots[anchor]:
            continue
        if is_local(pairings.local, slots[anchor], slots[c]):
            out[c] = squared(follow(pairings, path, p + 1, c))
    out[anchor] = of_anchor


@compiled
def support_of(pairings: Pairings, path: Path, anchor: int, gate: float) -> int:
    """Number of other measurements with a candidate within the gate after an update with the anchor."""
    p, slots, measured = pairings.fixed, pairings.slots, pairings.measured
    e = follow(pairings, path, p, anchor)
    if squared(e) == math.inf:
        return 0
    append(path, p, anchor, e)
    support, last = 0, measured[anchor]
    for c in range(p, len(slots)):
        if measured[c] == last or measured[c] == measured[anchor] or slots[c] == slots[anchor]:
            continue
        if is_local(pairings.local, slots[anchor], slots[c]) and squared(follow(pairings, path, p + 1, c)) < gate:
            support, last = support + 1, measured[c]
    return support
