"""What a `FeatureIndex` asks of a map beforehand: relative errors, densities, how far its triangles reach."""

from __future__ import annotations

import functools
import math

import numpy as np
from scipy.spatial import cKDTree

from slam_gym._compile import compiled
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation.arrays import map_arrays
from slam_gym.association.relocation.constraints import Mapped, difference_covariance, mapped_of
from slam_gym.types import Array, IntArray, Landmarks

_WITHIN = 23  # features within reach of each
_SAMPLE = 200  # features by whose surroundings the reach is judged
_NEAREST = 24  # features around each that its error is taken relative to, every other one of them
_ORDERS = 64  # powers of density kept


def usual_reach(positions: Array, triangles: float) -> float:
    """Longest side [m] of triangles with some 23 features within it, and so many triangles per feature at most.

    11 m where there are fewer than three features. Judged by the surroundings of some 200 features.
    """
    n = len(positions)
    if n < 3 or not np.isfinite(positions).all():
        return 11.0
    tree, sample = cKDTree(positions), np.arange(0, n, max(n // _SAMPLE, 1))
    near = min(_WITHIN, n - 1)
    reach = max(float(np.median(tree.query(positions[sample], k=near + 1)[0][:, near])), 1e-3)
    for _ in range(20):
        around = tree.query_ball_point(positions[sample], reach)
        if sum(_corners(positions[rows], reach) for rows in around) / 3.0 <= triangles * len(sample):
            break
        reach *= 0.9
    return reach


@compiled
def _corners(around: Array, reach: float) -> int:
    """Pairs of the points around one, itself among them and no part of a pair, that are within reach of each other."""
    pairs = 1 - len(around)
    for i in range(len(around)):
        for j in range(i):
            dx, dy = around[i, 0] - around[j, 0], around[i, 1] - around[j, 1]
            pairs += dx * dx + dy * dy <= reach * reach
    return pairs


def relative_covariances(landmarks: Landmarks) -> Array:
    """Covariance of each feature relative to those around it, (n, 2, 2) [m²].

    The vector between features j and l has covariance D_jl = P_jj + P_ll − P_jl − P_lj, in which error that both share
    drops out. C_j is what makes D_jl ≈ C_j + C_l in the mean over near features l. Without cross-covariances it is
    P_jj. Raises ValueError as `map_arrays` does.
    """
    mapped, n = mapped_of(map_arrays(landmarks)), len(landmarks)
    if n < 2 or (len(mapped.covariance) == 0 and len(mapped.blocks) == 0):
        return mapped.covariances.copy()
    near = cKDTree(mapped.positions).query(mapped.positions, k=min(_NEAREST + 1, n))[1][:, 1::2]
    return _relative(mapped, np.ascontiguousarray(near, np.int64))


@compiled
def _relative(mapped: Mapped, near: IntArray) -> Array:
    n, count = near.shape
    half, out = np.zeros((n, 3)), np.empty((n, 2, 2))
    for j in range(n):
        for l in near[j]:
            xx, xy, yy = difference_covariance(mapped, j, l)
            half[j, 0], half[j, 1], half[j, 2] = half[j, 0] + xx, half[j, 1] + xy, half[j, 2] + yy
        half[j] /= 2.0 * count
    for j in range(n):
        xx, xy, yy = 2.0 * half[j, 0], 2.0 * half[j, 1], 2.0 * half[j, 2]
        for l in near[j]:
            xx, xy, yy = xx - half[l, 0] / count, xy - half[l, 1] / count, yy - half[l, 2] / count
        # Where the neighbours are known much worse, too little or nothing is left of C_j: half of the mean over D_jl is
        # taken instead, as if j and its neighbours were known equally well.
        if not (xx > 0.5 * half[j, 0] and yy > 0.5 * half[j, 2] and xx * yy > xy * xy):
            xx, xy, yy = half[j, 0], half[j, 1], half[j, 2]
        out[j, 0, 0], out[j, 0, 1], out[j, 1, 0], out[j, 1, 1] = max(xx, 0.0), xy, xy, max(yy, 0.0)
    return out


def crowding(positions: Array, width: float) -> Array:
    """Σ_j λ_j^p for p = 0 … 63, (64,) [1/m^2p]: powers of the density around each feature, in squares of `width` [m].

    Estimated as in `acceptance`: by the falling factorial of the number of others in the square, or by the power of the
    mean density where that is more.
    """
    n = len(positions)
    if n == 0:
        return np.zeros(_ORDERS)
    others = cKDTree(positions).query_ball_point(positions, width / 2.0, p=np.inf, return_length=True) - 1.0
    area, sums, falling = width * width, np.empty(_ORDERS), np.ones(n)
    for order in range(_ORDERS):
        sums[order] = max(float(falling.sum()), n * (float(others.mean()) / area) ** order)
        falling *= np.maximum(others - order, 0.0) / area
    return sums


@compiled
def first_bad_feature(positions: Array, covariances: Array) -> tuple[int, int]:
    """(feature, fault): 1 position not finite, 2 covariance none; (−1, 0) where all are good."""
    for j in range(len(positions)):
        if not math.isfinite(positions[j, 0] + positions[j, 1]):
            return j, 1
        xx, xy, yx, yy = covariances[j, 0, 0], covariances[j, 0, 1], covariances[j, 1, 0], covariances[j, 1, 1]
        good = math.isfinite(xx + xy + yx + yy) and xx >= 0.0 and yy >= 0.0 and abs(xy - yx) <= 1e-9 * (xx + yy)
        if not good or xx * yy - xy * yx < -1e-9 * xx * yy:
            return j, 2
    return -1, 0


@functools.lru_cache(maxsize=256)
def chance_tubes(m: int, confidence: float) -> Array:
    """2π k √(k − 1) V_{2k−3} γ^{(2k−3)/2} for k = 0 … m, (m + 1,), with γ = χ²_{2k−3,conf}; not to be changed."""
    tubes = np.zeros(m + 1)
    for k in range(2, m + 1):
        d, gate = 2 * k - 3, chi2_gate(2 * k - 3, confidence)
        ball = math.exp(0.5 * d * math.log(math.pi * gate) - math.lgamma(0.5 * d + 1.0))
        tubes[k] = 2.0 * math.pi * k * math.sqrt(k - 1) * ball
    return tubes


@compiled
def least_pairings(
    points: Array, noise: Array, starts: Array, tubes: Array, variance: float, probability: float
) -> int:
    """The least k ≥ 3 from which on fewer than `probability` hypotheses are expected by chance (see `acceptance`)."""
    m = len(points)
    sums, area, x, y, square = np.zeros(m + 1), 0.0, 0.0, 0.0, 0.0
    sums[0] = 1.0
    for i in range(m):
        xx, yy, xy = noise[i, 0, 0] + variance, noise[i, 1, 1] + variance, noise[i, 0, 1]
        own = math.sqrt(max(xx * yy - xy * xy, 1e-24))
        area, x, y = area + own / m, x + points[i, 0] / m, y + points[i, 1] / m
        for k in range(i + 1, 0, -1):
            sums[k] += sums[k - 1] * own
    for i in range(m):
        square += ((points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2) / max(m - 1, 1)
    for k in range(m, 2, -1):
        density = starts[min(k - 1, len(starts) - 1)]
        if density * sums[k] * tubes[k] * math.sqrt(square) / area**1.5 >= probability:
            return k + 1
    return 3
