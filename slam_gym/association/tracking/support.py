"""What one pairing says about all others: the state updated with it, and who is still compatible then.

With the pairings given and one more, the anchor, in the Cholesky factor S_H = L Lᵀ and y = L⁻¹ν_H, another candidate c
is at D²_c = e_cᵀ(S_c − w_cᵀw_c)⁻¹e_c with w_c = L⁻¹S_{H,c} and e_c = ν_c − w_cᵀy: its individual distance after an EKF
update with H (the same numbers as in `tree.append_pairing`).
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.tree import Tree, append_pairing, root
from slam_gym.types import Array, BoolArray, IntArray

Arrays = tuple[IntArray, IntArray, Array, Array, Array, BoolArray]
"""Candidates as compiled functions take them: slots (c,), measured (c,), innovations (c, 2), noise (m, 2, 2), joint
covariance of the slots (2u, 2u), locality of the slots (u, u) or (0, 0)."""

_UNRESTRICTED = np.empty((0, 0), np.bool_)


def arrays(tree: Tree) -> Arrays:
    """The candidates of a tree."""
    c = tree.candidates
    local = _UNRESTRICTED if tree.local is None else tree.local
    return tree.slots, c.measured, c.innovations, tree.scan.covariances, tree.covariance, local


def given(tree: Tree, room: int) -> tuple[IntArray, Array, Array]:
    """Slots (g + room,), L and y of the pairings given, with room for `room` more."""
    node, g = root(tree), tree.pairings_given
    path, factor, whitened = np.zeros(g + room, np.int64), np.zeros((2 * (g + room),) * 2), np.zeros(2 * (g + room))
    path[:g], factor[: 2 * g, : 2 * g], whitened[: 2 * g] = node.slots, node.factor, node.whitened
    return path, factor, whitened


@compiled
def distances_given(
    path: IntArray, factor: Array, whitened: Array, p: int, candidates: Arrays, anchor: int, out: Array
) -> None:
    """D² (c,) of each candidate after an update with the p pairings of `path` and the anchor; inf where it cannot be.

    The anchor's own is that after an update with the p pairings only; those are all where `anchor` < 0. Entries p and
    p + 1 of `path`, `factor` and `whitened` are overwritten.
    """
    slots, measured, innovations, noise, covariance, local = candidates
    q, own = p, 0.0
    if anchor >= 0:
        s, i = slots[anchor], measured[anchor]
        own = append_pairing(factor, whitened, path, p, covariance, s, innovations[anchor], noise[i])
        path[p] = s
        q = p + 1
    for c in range(len(slots)):
        out[c] = own if c == anchor else math.inf
        if own == math.inf:
            continue
        if anchor >= 0:
            if measured[c] == measured[anchor] or slots[c] == slots[anchor]:
                continue
            if local.size > 0 and not local[slots[anchor], slots[c]]:
                continue
        out[c] = append_pairing(factor, whitened, path, q, covariance, slots[c], innovations[c], noise[measured[c]])


@compiled
def anchor_support(path: IntArray, factor: Array, whitened: Array, p: int, candidates: Arrays, gate: float) -> IntArray:
    """How many other measurements (c,) have a candidate within the gate, after an update with each candidate alone."""
    measured = candidates[1]
    support, distances = np.zeros(len(measured), np.int64), np.empty(len(measured))
    for anchor in range(len(measured)):
        distances_given(path, factor, whitened, p, candidates, anchor, distances)
        last = -1
        for c in range(len(measured)):
            if distances[c] < gate and c != anchor and measured[c] != last:
                last = measured[c]
                support[anchor] += 1
    return support
