"""Branch and bound over hypotheses whose distance is taken at the best heading: the search of `ipjc`.

For a robot turned by φ from its predicted heading, a feature predicted at p̂_j lies at Rot(−φ)(p̂_j + δ_j), so that
measurement i, turned into the predicted axes, misses it by

    e(φ) = ν + (cos φ − 1) z_i + sin φ J z_i − φ a_j,   a_j = J p̂_j + c_j / σ²,   J = [0 −1; 1 0],

where σ² is the variance of the heading and c_j = Cov(h_j, θ); δ given φ is Gaussian with covariance S − c cᵀ/σ². The
four vectors of e are whitened once for each pairing by L of that covariance plus noise, S_{H|θ} = L Lᵀ, as ν is in
`branch_and_bound`; with G the 4 × 4 matrix of their products and q = (1, cos φ − 1, sin φ, −φ),

    D²_H = min over φ of φ²/σ² + qᵀ G q

costs no more for many pairings than for one. Noise keeps the axes that it has at the predicted heading.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.types import NONE, Array, BoolArray, IntArray

_ITERATIONS = 30
_CONVERGED = 1e-10  # [rad]


class _Stack(NamedTuple):
    """By p, the number of pairings of the hypothesis H on the path: what may follow, conditioned on H and heading."""

    alive: IntArray  # (P + 1, c) candidates that can still be legal, level by level
    end: IntArray  # (P + 1,)
    levels: IntArray  # (P + 1,) of the candidates alive, less those decided with `*` since
    features: IntArray  # (P + 1,) of the candidates alive
    total: Array  # (P + 1, c) D² of H and the candidate
    turn: Array  # (P + 1, c) [rad] φ there
    error: Array  # (P + 1, c, 2, 4) the four vectors of e, less what H explains of them
    schur: Array  # (P + 1, c, 3) covariance of e, less the same: xx, xy, yy
    w: Array  # (c, 2P + 2, 2) L⁻¹ S_{H,c}
    products: Array  # (P + 1, 4, 4) G
    distance: Array  # (P + 1,) D²_H


@compiled
def search(
    slots: IntArray,
    measured: IntArray,
    errors: Array,
    noise: Array,
    covariance: Array,
    variance: float,
    local: BoolArray,
    held: int,
    gates: Array,
    node_limit: int,
) -> tuple[IntArray, float, int, int, bool]:
    """The hypothesis with most pairings, then least D²: its candidates (b,), D², nodes, joint tests, limit hit.

    Candidates (c,): first the `held` pairings, which are in every hypothesis, then level by level. errors (c, 2, 4) at
    the prediction; covariance (2u, 2u) of the slots given the heading; `variance` of the heading.
    """
    depth, count = len(gates), len(slots)
    stack = _Stack(
        np.empty((depth, count), np.int64), np.zeros(depth, np.int64), np.zeros(depth, np.int64),
        np.zeros(depth, np.int64), np.empty((depth, count)), np.zeros((depth, count)), np.empty((depth, count, 2, 4)),
        np.empty((depth, count, 3)), np.empty((count, 2 * depth, 2)), np.zeros((depth, 4, 4)), np.zeros(depth),
    )  # fmt: skip
    tests = _start(stack, slots, measured, errors, noise, covariance, variance)
    path, position, level = np.empty(depth, np.int64), np.zeros(depth, np.int64), np.full(depth, NONE)
    best_path, best, best_distance, p, nodes, limit_hit = path[:0].copy(), 0, 0.0, 0, 0, False
    while p >= 0:
        bound = p + min(stack.levels[p], stack.features[p])
        done = position[p] == stack.end[p] or (p < held and position[p] > 0)
        if done or bound < best or (bound == best and not stack.distance[p] < best_distance):
            p -= 1
            continue
        if nodes == node_limit:
            limit_hit = True
            break
        c = stack.alive[p, position[p]]
        if level[p] == NONE:
            level[p] = measured[c]
        if measured[c] != level[p]:  # `*`
            nodes += 1
            stack.levels[p] -= 1
            level[p] = measured[c]
            continue
        position[p] += 1
        if c >= held:
            if not stack.total[p, c] < gates[p + 1]:
                continue
            nodes += 1
        path[p] = c
        tests += _pair(stack, p, c, position[p], slots, measured, covariance, variance, local, held, gates)
        p += 1
        position[p], level[p] = 0, NONE
        if p > best or (p == best and stack.distance[p] < best_distance):
            best, best_distance, best_path = p, stack.distance[p], path[:p].copy()
    return best_path, best_distance, nodes, tests, limit_hit


@compiled
def least_distance(G: Array, variance: float, phi: float) -> tuple[float, float]:
    """min over φ of φ²/σ² + qᵀ G q, and φ there: Gauss-Newton from `phi`; at φ = 0 where the heading is known."""
    if not variance > 0.0:
        return float(G[0, 0]), 0.0
    value = _value(G, variance, phi)
    for _ in range(_ITERATIONS):
        c, s = math.cos(phi), math.sin(phi)
        first, second = phi / variance, 1.0 / variance
        for i in range(4):
            d = 0.0 if i == 0 else (-s if i == 1 else (c if i == 2 else -1.0))
            first += d * (G[i, 0] + G[i, 1] * (c - 1.0) + G[i, 2] * s - G[i, 3] * phi)
            second += d * (-G[i, 1] * s + G[i, 2] * c - G[i, 3])
        step = -first / second
        after = _value(G, variance, phi + step)
        while after > value and abs(step) > _CONVERGED:
            step *= 0.5
            after = _value(G, variance, phi + step)
        if abs(step) <= _CONVERGED:
            break
        phi, value = phi + step, after
    return value, phi


@compiled
def _value(G: Array, variance: float, phi: float) -> float:
    x, y = math.cos(phi) - 1.0, math.sin(phi)
    total = phi * phi / variance + G[0, 0] + x * x * G[1, 1] + y * y * G[2, 2] + phi * phi * G[3, 3]
    total += 2.0 * (x * G[0, 1] + y * G[0, 2] - phi * G[0, 3] + x * y * G[1, 2] - x * phi * G[1, 3] - y * phi * G[2, 3])
    return float(total)


@compiled
def _products(G: Array, error: Array, xx: float, xy: float, yy: float) -> Array:
    """G with one more pairing: + errorᵀ S⁻¹ error for error (2, 4) and its covariance S."""
    lx = math.sqrt(xx)
    lyx = xy / lx
    ly = math.sqrt(yy - lyx * lyx)
    out, u, v = np.empty((4, 4)), np.empty(4), np.empty(4)
    for i in range(4):
        u[i] = error[0, i] / lx
        v[i] = (error[1, i] - lyx * u[i]) / ly
    for i in range(4):
        for j in range(4):
            out[i, j] = G[i, j] + u[i] * u[j] + v[i] * v[j]
    return out


@compiled
def _start(
    stack: _Stack, slots: IntArray, measured: IntArray, errors: Array, noise: Array, covariance: Array, variance: float
) -> int:
    """The empty hypothesis: everything may follow. Joint tests made."""
    for c in range(len(slots)):
        R, s = noise[measured[c]], 2 * slots[c]
        xx, yy = covariance[s, s] + R[0, 0], covariance[s + 1, s + 1] + R[1, 1]
        xy = covariance[s, s + 1] + R[0, 1]
        stack.alive[0, c], stack.error[0, c] = c, errors[c]
        stack.schur[0, c, 0], stack.schur[0, c, 1], stack.schur[0, c, 2] = xx, xy, yy
        if not (xx > 0.0 and xx * yy - xy * xy > 0.0):
            stack.total[0, c] = math.inf
            continue
        G = _products(stack.products[0], stack.error[0, c], xx, xy, yy)
        stack.total[0, c], stack.turn[0, c] = least_distance(G, variance, 0.0)
    stack.end[0] = len(slots)
    _count(stack, 0, slots, measured)
    return len(slots)


@compiled
def _count(stack: _Stack, p: int, slots: IntArray, measured: IntArray) -> None:
    """Levels and features of the candidates alive at p."""
    met, last, levels, features = np.zeros(slots.max() + 1, np.bool_), NONE, 0, 0
    for c in stack.alive[p, : stack.end[p]]:
        if measured[c] != last:
            last = measured[c]
            levels += 1
        if not met[slots[c]]:
            met[slots[c]] = True
            features += 1
    stack.levels[p], stack.features[p] = levels, features


@compiled
def _pair(
    stack: _Stack, p: int, d: int, first: int, slots: IntArray, measured: IntArray, covariance: Array, variance: float,
    local: BoolArray, held: int, gates: Array,
) -> int:  # fmt: skip
    """Candidate d joins the p pairings of H: fill entry p + 1 of the stack from alive[p, first:]. Joint tests made.

    D² never shrinks along a path, so what exceeds the gate of the largest hypothesis it could complete is dropped.
    """
    q, kept, tests, before, last = p + 1, 0, 0, 0, measured[d]
    xx, xy, yy = stack.schur[p, d]
    lx = math.sqrt(xx)
    lyx = xy / lx
    ly = math.sqrt(yy - lyx * lyx)
    stack.products[q] = _products(stack.products[p], stack.error[p, d], xx, xy, yy)
    stack.distance[q], phi = stack.total[p, d], stack.turn[p, d]
    a, cross, w = 2 * slots[d], np.empty((2, 2)), stack.w
    for k in range(first, stack.end[p]):
        c = stack.alive[p, k]
        if measured[c] == measured[d] or slots[c] == slots[d]:
            continue
        if p == held and local.size > 0 and not local[slots[d], slots[c]]:
            continue
        b = 2 * slots[c]
        for r in range(2):
            for s in range(2):
                cross[r, s] = covariance[a + r, b + s]
                for k2 in range(2 * p):
                    cross[r, s] -= w[d, k2, r] * w[c, k2, s]
        for s in range(2):
            cross[0, s] /= lx
            cross[1, s] = (cross[1, s] - lyx * cross[0, s]) / ly
        xx = stack.schur[p, c, 0] - cross[0, 0] ** 2 - cross[1, 0] ** 2
        xy = stack.schur[p, c, 1] - cross[0, 0] * cross[0, 1] - cross[1, 0] * cross[1, 1]
        yy = stack.schur[p, c, 2] - cross[0, 1] ** 2 - cross[1, 1] ** 2
        if not (xx > 0.0 and xx * yy - xy * xy > 0.0):
            continue
        for v in range(4):
            u0 = stack.error[p, d, 0, v] / lx
            u1 = (stack.error[p, d, 1, v] - lyx * u0) / ly
            for s in range(2):
                stack.error[q, c, s, v] = stack.error[p, c, s, v] - cross[0, s] * u0 - cross[1, s] * u1
        tests += 1
        G = _products(stack.products[q], stack.error[q, c], xx, xy, yy)
        total, turn = least_distance(G, variance, phi)
        before += int(measured[c] != last and c >= held)
        last = measured[c]
        if not total < gates[min(q + before, len(gates) - 1)] and c >= held:
            continue
        for r in range(2):
            w[c, 2 * p + r, 0], w[c, 2 * p + r, 1] = cross[r, 0], cross[r, 1]
        stack.schur[q, c, 0], stack.schur[q, c, 1], stack.schur[q, c, 2] = xx, xy, yy
        stack.total[q, c], stack.turn[q, c] = total, turn
        stack.alive[q, kept] = c
        kept += 1
    stack.end[q] = kept
    _count(stack, q, slots, measured)
    return tests
