"""What may still follow a path of the interpretation tree, kept conditioned on the pairings H of the path.

With S_H = L Lᵀ and y = L⁻¹ν_H, candidate c has w_c = L⁻¹S_{H,c}, e_c = ν_c − w_cᵀy and the Schur complement
S_c − w_cᵀw_c, so that D² of H ∪ {c} = D²_H + e_cᵀ(S_c − w_cᵀw_c)⁻¹e_c. A pairing appends two rows to every w_c.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._compile import compiled
from slam_gym.types import NONE, Array, BoolArray, IntArray


@compiled
def unconditioned(
    slots: IntArray, innovations: Array, measured: IntArray, noise: Array, covariance: Array, levels: int
) -> tuple[Array, Array, Array, Array]:
    """w (c, 2l, 2), e (c, 2), S (c, 3) xx xy yy and D² (c,) of all candidates, given nothing."""
    count = len(slots)
    w, schur, total = np.empty((count, 2 * levels, 2)), np.empty((count, 3)), np.empty(count)
    for c in range(count):
        s, i = 2 * slots[c], measured[c]
        schur[c, 0] = covariance[s, s] + noise[i, 0, 0]
        schur[c, 1] = covariance[s, s + 1] + noise[i, 0, 1]
        schur[c, 2] = covariance[s + 1, s + 1] + noise[i, 1, 1]
        total[c] = _mahalanobis(innovations[c, 0], innovations[c, 1], schur[c, 0], schur[c, 1], schur[c, 2])
    return w, innovations.copy(), schur, total


@compiled
def _mahalanobis(x: float, y: float, xx: float, xy: float, yy: float) -> float:
    """D² of (x, y); inf where the covariance is singular."""
    determinant = xx * yy - xy * xy
    return (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant if determinant > 0.0 else math.inf


@compiled
def _given(
    a: int, c: int, p: int, slots: IntArray, covariance: Array, w: Array, error: Array, schur: Array
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """What pairing a does to candidate c: the rows appended to w_c (4), then e_c (2) and the Schur complement (3)."""
    s, t = 2 * slots[a], 2 * slots[c]
    ax, ay, bx, by = covariance[s, t], covariance[s, t + 1], covariance[s + 1, t], covariance[s + 1, t + 1]
    for q in range(2 * p):
        ax, ay = ax - w[a, q, 0] * w[c, q, 0], ay - w[a, q, 0] * w[c, q, 1]
        bx, by = bx - w[a, q, 1] * w[c, q, 0], by - w[a, q, 1] * w[c, q, 1]
    first = math.sqrt(schur[a, 0])
    cross = schur[a, 1] / first
    second = math.sqrt(schur[a, 2] - cross * cross)
    ax, ay = ax / first, ay / first
    bx, by = (bx - cross * ax) / second, (by - cross * ay) / second
    u = error[a, 0] / first
    v = (error[a, 1] - cross * u) / second
    x, y = error[c, 0] - ax * u - bx * v, error[c, 1] - ay * u - by * v
    xx, xy = schur[c, 0] - ax * ax - bx * bx, schur[c, 1] - ax * ay - bx * by
    return ax, ay, bx, by, x, y, xx, xy, schur[c, 2] - ay * ay - by * by


@compiled
def condition(
    a: int, first: int, p: int, slots: IntArray, covariance: Array, w: Array, error: Array, schur: Array, total: Array
) -> None:
    """Condition the candidates from `first` on, on pairing a as the p-th of the path. In place."""
    for c in range(first, len(slots)):
        ax, ay, bx, by, x, y, xx, xy, yy = _given(a, c, p, slots, covariance, w, error, schur)
        w[c, 2 * p, 0], w[c, 2 * p, 1], w[c, 2 * p + 1, 0], w[c, 2 * p + 1, 1] = ax, ay, bx, by
        error[c, 0], error[c, 1], schur[c, 0], schur[c, 1], schur[c, 2] = x, y, xx, xy, yy
        total[c] = _mahalanobis(x, y, xx, xy, yy)


@compiled
def legal(
    first: int, last: int, slots: IntArray, taken: BoolArray, joint: bool, total: Array, slack: float
) -> IntArray:
    """Candidates of a level that add less than `slack` to D²_H; with `joint`, of features that are not taken."""
    legal, count = np.empty(last - first, np.int64), 0
    for c in range(first, last):
        if total[c] < slack and not (joint and taken[slots[c]]):
            legal[count] = c
            count += 1
    return legal[:count]


@compiled
def outlook(
    offered: IntArray, first: int, slots: IntArray, measured: IntArray, covariance: Array, w: Array, error: Array,
    schur: Array, total: Array, taken: BoolArray, p: int, distance: float, gates: Array,
) -> tuple[IntArray, IntArray, int, int]:  # fmt: skip
    """What lies beyond the level at hand, whose successors' candidates begin with `first`.

    By candidate of `offered` (k,): levels that could be paired right after it; later candidates of the same feature.
    Then the levels that could be paired next if it is none of them, and the levels that have a candidate at all.
    """
    supported, rivals = np.zeros(len(offered), np.int64), np.zeros(len(offered), np.int64)
    after, none = gates[min(p + 2, len(gates) - 1)], gates[min(p + 1, len(gates) - 1)]
    for k in range(len(offered)):
        a = offered[k]
        counted = NONE
        for c in range(first, len(slots)):
            rivals[k] += slots[c] == slots[a]
            if measured[c] == counted or taken[slots[c]] or slots[c] == slots[a]:
                continue
            _, _, _, _, x, y, xx, xy, yy = _given(a, c, p, slots, covariance, w, error, schur)
            if distance + total[a] + _mahalanobis(x, y, xx, xy, yy) < after:
                supported[k], counted = supported[k] + 1, measured[c]
    left, without, seen, counted = 0, 0, NONE, NONE
    for c in range(first, len(slots)):
        if measured[c] != seen:
            left, seen = left + 1, measured[c]
        if measured[c] != counted and not taken[slots[c]] and distance + total[c] < none:
            without, counted = without + 1, measured[c]
    return supported, rivals, without, left
