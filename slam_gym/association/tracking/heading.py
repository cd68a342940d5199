"""D² of a hypothesis at the heading that fits it best: what `ipjc` puts in the place of the linear D².

For a robot turned by φ from its predicted heading, a feature predicted at p̂_j lies at Rot(−φ)(p̂_j + δ_j), so that
measurement i, turned into the predicted axes, misses it by

    e(φ) = ν + (cos φ − 1) z_i + sin φ J z_i − φ a_j,   a_j = J p̂_j + c_j / σ²,   J = [0 −1; 1 0],

where σ² is the variance of the heading and c_j = Cov(h_j, θ); δ given φ is Gaussian with covariance S − c cᵀ/σ². The
four vectors of e are conditioned on the path as ν alone is in `tree.condition`. With G the 4 × 4 matrix of their
products, whitened by S_{H|θ}, and q = (1, cos φ − 1, sin φ, −φ),

    D²_H = min over φ of φ²/σ² + qᵀ G q

costs no more for many pairings than for one. Noise keeps the axes that it has at the predicted heading.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled, inlined
from slam_gym.association.tree import Innovation, Pivot, pivot_of
from slam_gym.types import Array

_ITERATIONS = 30
_CONVERGED = 1e-10  # [rad]


class Turning(NamedTuple):
    """The heading, and by p, the number of pairings of the hypothesis H on the path: what H makes of it."""

    variance: float  # [rad²] σ²
    errors: Array  # (P + 1, c, 2, 3) [m] z_i, J z_i and a_j of each candidate, less what H explains of them
    whitened: Array  # (P + 1, 2, 3) those of the pairing that joined H, times l⁻¹ as in `tree.Pivot`
    products: Array  # (P + 1, 4, 4) G
    headings: Array  # (P + 1,) [rad] φ of H
    candidate_headings: Array  # (P + 1, c) [rad] φ of H and the candidate


class BestHeading(NamedTuple):
    """The heading that explains a hypothesis best."""

    distance: float  # D² there
    heading: float  # [rad] φ


@compiled
def distance_with(turning: Turning, p: int, c: int, e: Innovation) -> float:
    """D² of the p pairings of H and candidate c with innovation e; inf where its covariance is none."""
    if not (e.xx > 0.0 and e.xx * e.yy - e.xy * e.xy > 0.0):
        return math.inf
    G = np.empty((4, 4))
    _products(turning, p, c, pivot_of(0, e), G, np.empty((2, 3)))
    found = least_distance(G, turning.variance, turning.headings[p])
    turning.candidate_headings[p, c] = found.heading
    return found.distance


@compiled
def join(turning: Turning, p: int, d: int, pivot: Pivot) -> None:
    """Candidate d joins the p pairings of H."""
    _products(turning, p, d, pivot, turning.products[p + 1], turning.whitened[p])
    turning.headings[p + 1] = turning.candidate_headings[p, d]


@inlined
def condition_errors(turning: Turning, w: Array, p: int, c: int) -> None:
    """The errors of candidate c given the p-th pairing as well, once rows 2p and 2p + 1 of w[c] are there."""
    for r in range(2):
        for v in range(3):
            explained = w[c, 2 * p, r] * turning.whitened[p, 0, v] + w[c, 2 * p + 1, r] * turning.whitened[p, 1, v]
            turning.errors[p + 1, c, r, v] = turning.errors[p, c, r, v] - explained


@inlined
def _products(turning: Turning, p: int, c: int, pivot: Pivot, out: Array, whitened: Array) -> None:
    """G of H and candidate c, with its `pivot`, to `out`; its errors times l⁻¹ to `whitened`."""
    error, G = turning.errors[p, c], turning.products[p]
    u, v = np.empty(4), np.empty(4)
    u[0], v[0] = pivot.u, pivot.v
    for k in range(3):
        u[k + 1] = error[0, k] * pivot.inverse_xx
        v[k + 1] = (error[1, k] - pivot.yx * u[k + 1]) * pivot.inverse_yy
        whitened[0, k], whitened[1, k] = u[k + 1], v[k + 1]
    for i in range(4):
        for j in range(4):
            out[i, j] = G[i, j] + u[i] * u[j] + v[i] * v[j]


@inlined
def least_distance(G: Array, variance: float, phi: float) -> BestHeading:
    """min over φ of φ²/σ² + qᵀ G q, and φ there: Gauss-Newton from `phi`."""
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
    return BestHeading(value, phi)


@inlined
def _value(G: Array, variance: float, phi: float) -> float:
    x, y = math.cos(phi) - 1.0, math.sin(phi)
    total = phi * phi / variance + G[0, 0] + x * x * G[1, 1] + y * y * G[2, 2] + phi * phi * G[3, 3]
    total += 2.0 * (x * G[0, 1] + y * G[0, 2] - phi * G[0, 3] + x * y * G[1, 2] - x * phi * G[1, 3] - y * phi * G[2, 3])
    return float(total)
