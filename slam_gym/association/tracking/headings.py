"""An uncertain heading split into narrow ones, in each of which the prediction is linear.

Where a feature at range r is predicted to lie depends on the heading by a rotation, which a Gaussian prediction
replaces by its tangent: off by r φ²/2 for a robot that has turned by φ more than it believes. A heading of variance σ²
is as good as a mixture of headings φ_k of variance s², with weights by N(φ_k; 0, σ² − s²). For one of them, with a_j as
in `heading`, feature j is predicted at m_j = Rot(−φ_k)(p̂_j + φ_k a_j), with

    S_jl|k = Rot(−φ_k)(S_jl − c_j c_lᵀ/σ²) Rot(φ_k) + s² g_j g_lᵀ,   g_j = Rot(−φ_k) a_j − J m_j,

and is linear in what is left of the heading.

A prediction that allows for the bend itself (`MapSpec.second_order`) has it twice in its parts: their means and
covariances are off by up to a fifth at σ = .3 rad. Maps come out better all the same than with one Gaussian.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.prediction import Expected, joint
from slam_gym.types import Array, IntArray

NARROW = 0.08  # [rad] s: at 6 m the tangent is off by 2 cm
_WIDE = 0.09  # [rad] σ from which a heading is split
_SIGMAS = 2.0  # of √(σ² − s²) that the headings cover …
_MOST = 5  # … but no more of them than so many to either side


class Part(NamedTuple):
    """One narrow heading of the mixture."""

    log_weight: float
    variance: float  # [rad²] of the heading in it
    positions: Array  # (k, 2) [m]
    covariances: Array  # (k, 2, 2) [m²]
    phi: float  # [rad] φ_k
    across: Array  # (k, 2) [m/rad] g_j
    given: Array  # (2k, 2k) [m²] covariance once the heading is known, or (0, 0) where the heading is not split


@compiled
def whole(expected: Expected) -> Part:
    """The prediction itself, as if its heading were narrow."""
    variance, unsplit = expected.pose[3], np.empty((0, 0))
    return Part(0.0, variance, expected.positions, expected.covariances, 0.0, expected.across, unsplit)


@compiled
def parts_of(expected: Expected) -> list[Part]:
    """The narrow headings of a prediction: one, itself, where its heading is well known."""
    positions, k, sigma2 = expected.positions, len(expected.positions), expected.pose[3]
    if not math.sqrt(max(sigma2, 0.0)) > _WIDE or k == 0:
        return [whole(expected)]
    given, slope = joint(expected, np.arange(k)), expected.across / sigma2
    slopes, one = slope.copy().reshape(2 * k), np.empty(1, np.int64)
    for i in range(2 * k):
        for j in range(2 * k):
            given[i, j] -= slopes[i] * slopes[j] * sigma2
    phis, weights = _split(sigma2)
    out: list[Part] = []
    for phi, weight in zip(phis, weights):
        c, s, moved, g = math.cos(phi), math.sin(phi), np.empty((k, 2)), np.empty((k, 2))
        part = Part(math.log(weight), NARROW * NARROW, moved, np.empty((k, 2, 2)), phi, g, given)
        for j in range(k):
            ax, ay = slope[j, 0] - positions[j, 1], slope[j, 1] + positions[j, 0]
            x, y = positions[j, 0] + phi * ax, positions[j, 1] + phi * ay
            moved[j, 0], moved[j, 1] = c * x + s * y, c * y - s * x
            g[j, 0], g[j, 1] = c * ax + s * ay + moved[j, 1], c * ay - s * ax - moved[j, 0]
            one[0] = j
            part.covariances[j] = joint_in(expected, part, one)
        out.append(part)
    return out


@compiled
def _split(sigma2: float) -> tuple[Array, Array]:
    """The headings φ_k [rad] (h,) that a variance [rad²] is split into, and their weights."""
    spread, total = math.sqrt(sigma2 - NARROW * NARROW), 0.0
    n = min(math.ceil(0.5 * _SIGMAS * spread / NARROW), _MOST)
    phis, weights = np.empty(2 * n + 1), np.empty(2 * n + 1)
    for k in range(2 * n + 1):
        phis[k] = 2.0 * NARROW * (k - n)
        weights[k] = math.exp(-0.5 * (phis[k] / spread) ** 2)
        total += weights[k]
    return phis, weights / total


@compiled
def joint_in(expected: Expected, part: Part, rows: IntArray) -> Array:
    """(2r, 2r) [m²] covariance of the features at `rows` together, in a narrow heading."""
    if part.given.size == 0:
        return joint(expected, rows)
    given, c, s, v = part.given, math.cos(part.phi), math.sin(part.phi), NARROW * NARROW
    out = np.empty((2 * len(rows), 2 * len(rows)))
    for a in range(len(rows)):
        for b in range(len(rows)):
            i, j = 2 * rows[a], 2 * rows[b]
            xx, xy, yx, yy = given[i, j], given[i, j + 1], given[i + 1, j], given[i + 1, j + 1]
            ux, uy, vx, vy = c * xx + s * yx, c * xy + s * yy, c * yx - s * xx, c * yy - s * xy
            g, h = part.across[rows[a]], part.across[rows[b]]
            out[2 * a, 2 * b] = c * ux + s * uy + v * g[0] * h[0]
            out[2 * a, 2 * b + 1] = c * uy - s * ux + v * g[0] * h[1]
            out[2 * a + 1, 2 * b] = c * vx + s * vy + v * g[1] * h[0]
            out[2 * a + 1, 2 * b + 1] = c * vy - s * vx + v * g[1] * h[1]
    return out
