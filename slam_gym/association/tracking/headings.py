"""An uncertain heading split into narrow parts, in each of which the prediction is linear.

The predicted position of a feature at range r depends on the heading by a rotation, which a Gaussian prediction
replaces by its tangent. The tangent is off by r φ²/2 for a robot that has turned by φ more than estimated. A heading of
variance σ² is approximated by a mixture of headings φ_k of variance s², with weights N(φ_k; 0, σ² − s²): the φ_k lie
2s apart, and the mixture has 0.75 to 0.99 of the variance σ² up to σ = 0.46 rad, a quarter at 1 rad. In part k, with
c_j = H_j P e_θ and a_j = J p̂_j + c_j/σ² (see `ipjc`), feature j is predicted at m_j = Rot(−φ_k)(p̂_j + φ_k a_j), with

    S_jl|k = Rot(−φ_k)(S_jl − c_j c_lᵀ/σ²) Rot(φ_k) + s² g_j g_lᵀ,   g_j = Rot(−φ_k) a_j − J m_j,

and depends linearly on the remaining heading error.

If the prediction itself is of second order (`MapSpec.second_order`), the curvature is counted twice in the parts: their
means and covariances are off by up to a fifth at σ = 0.3 rad. Maps are still better than with a single Gaussian.
"""

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.prediction import Expected, joint
from slam_gym.types import Array, IntArray

NARROW = 0.08  # [rad] s: the tangent is off by 2 cm at 6 m
_WIDE = 0.09  # [rad] σ above which a heading is split
_SIGMAS = 2.0  # of √(σ² − s²) that the parts cover …
_MOST = 5  # … but at most this many parts to either side


class Part(NamedTuple):
    """One narrow heading of the mixture."""

    log_weight: float
    variance: float  # [rad²] of the heading within the part
    positions: Array  # (k, 2) [m]
    covariances: Array  # (k, 2, 2) [m²]
    phi: float  # [rad] φ_k
    across: Array  # (k, 2) [m/rad] g_j
    conditional: Array  # (2k, 2k) [m²] covariance given the heading, or (0, 0) where the heading is not split


@compiled
def parts_of(expected: Expected) -> list[Part]:
    """The narrow headings of a prediction; a single part, the prediction itself, where the heading is well known."""
    positions, k, sigma2 = expected.positions, len(expected.positions), expected.pose[3]
    if not math.sqrt(max(sigma2, 0.0)) > _WIDE or k == 0:
        return [Part(0.0, sigma2, positions, expected.covariances, 0.0, expected.across, np.empty((0, 0)))]
    conditional, slope = joint(expected, np.arange(k)), expected.across / sigma2
    slopes, row = slope.copy().reshape(2 * k), np.empty(1, np.int64)
    for i in range(2 * k):
        for j in range(2 * k):
            conditional[i, j] -= slopes[i] * slopes[j] * sigma2
    spread = math.sqrt(sigma2 - NARROW * NARROW)
    n = min(math.ceil(0.5 * _SIGMAS * spread / NARROW), _MOST)  # parts to either side
    phis = 2.0 * NARROW * np.arange(-n, n + 1)
    scaled = phis / spread
    weights = np.exp(-0.5 * scaled * scaled)
    weights /= weights.sum()
    out: list[Part] = []
    for phi, weight in zip(phis, weights):
        c, s, moved, g = math.cos(phi), math.sin(phi), np.empty((k, 2)), np.empty((k, 2))
        part = Part(math.log(weight), NARROW * NARROW, moved, np.empty((k, 2, 2)), phi, g, conditional)
        for j in range(k):
            ax, ay = slope[j, 0] - positions[j, 1], slope[j, 1] + positions[j, 0]
            x, y = positions[j, 0] + phi * ax, positions[j, 1] + phi * ay
            moved[j, 0], moved[j, 1] = c * x + s * y, c * y - s * x
            g[j, 0], g[j, 1] = c * ax + s * ay + moved[j, 1], c * ay - s * ax - moved[j, 0]
            row[0] = j
            part.covariances[j] = joint_in(expected, part, row)
        out.append(part)
    return out


@compiled
def joint_in(expected: Expected, part: Part, rows: IntArray) -> Array:
    """(2r, 2r) [m²] joint covariance of the features at `rows` (r,) in a part."""
    if part.conditional.size == 0:
        return joint(expected, rows)
    conditional, c, s, v = part.conditional, math.cos(part.phi), math.sin(part.phi), NARROW * NARROW
    out = np.empty((2 * len(rows), 2 * len(rows)))
    for a in range(len(rows)):
        for b in range(len(rows)):
            i, j = 2 * rows[a], 2 * rows[b]
            xx, xy, yx, yy = conditional[i, j], conditional[i, j + 1], conditional[i + 1, j], conditional[i + 1, j + 1]
            ux, uy, vx, vy = c * xx + s * yx, c * xy + s * yy, c * yx - s * xx, c * yy - s * xy
            g, h = part.across[rows[a]], part.across[rows[b]]
            out[2 * a, 2 * b] = c * ux + s * uy + v * g[0] * h[0]
            out[2 * a, 2 * b + 1] = c * uy - s * ux + v * g[0] * h[1]
            out[2 * a + 1, 2 * b] = c * vx + s * vy + v * g[1] * h[0]
            out[2 * a + 1, 2 * b + 1] = c * vy - s * vx + v * g[1] * h[1]
    return out
