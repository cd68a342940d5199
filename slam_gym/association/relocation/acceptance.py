"""How many pairings a relocation must have before chance no longer explains them.

Let landmarks lie at random with density λ. A set of k measurements meets k of them by chance when, for some pose, the
errors satisfy D² < γ = χ²_{2k−3,conf}. Where the landmarks would have to lie is a tube of R^{2k} around the
three-dimensional surface of all poses. Whitened by S = Σ of scan and map, its cross-section is a ball of 2k − 3
dimensions and radius √γ, volume V_{2k−3} γ^{(2k−3)/2}, and the surface element is √det(AᵀS⁻¹A) = 1/√det Σ_pose (see
`located`). Integrated over the area of the map, λ·area = n, and over all headings, the expected number is

    n · 2π λ^{k−1} · √(det S / det Σ_pose) · V_{2k−3} γ^{(2k−3)/2},

for k = 2 the familiar n · λ · 2πd · 2√γ σ of an annulus. With independent errors of a_i = √det(R_i + P) per pairing,
det S = Π a_i² and 1/√det Σ_pose = k √(Σ|z − z̄|²) / σ³. Summed over all k of the m measurements,

    E_k = 2π · Σ_j λ_j^{k−1} · e_k(a_1 q_1, …, a_m q_m) · k √((k − 1) s²) / σ³ · V_{2k−3} γ^{(2k−3)/2},

e_k being the elementary symmetric polynomial, q_i the fraction of landmarks that pass the unary constraints of
measurement i, s² the variance of the scan's points, σ² the mean of a_i, and λ_j the density around landmark j within
what a scan covers, so that crowded corners count as such. With c_j other landmarks in that area A, λ_j^{k−1} is
estimated by c_j (c_j − 1) … (c_j − k + 2) / A^{k−1}, which is unbiased for a Poisson process, where a power of c_j / A
would not be; where the sum of those is the lesser, by n λ̄^{k−1} with the mean density.

Every further pairing makes E_k smaller by about λ π γ σ²: a hypothesis is believed from the first k on at which fewer
than `probability` are expected, hence one count above what chance brings.

Buildings are no Poisson process: corners and doors repeat along walls, and chance finds one pairing more than it
should. So one more is asked for, unless the pairings explain most of the scan, which in another building they do not.
(To refuse what is no better than for the mirror image of the scan in the same map makes wrong answers as few, but costs
a sixth of the right ones: many a room is its own mirror image.)
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation.arrays import map_arrays, scan_arrays
from slam_gym.association.relocation.constraints import Mapped, difference_covariance, mapped_of, unary_table
from slam_gym.types import Array, IntArray, Landmarks, Scan

EXPLAINED = 0.7  # fraction of a scan that, once paired, needs no margin
_SAMPLE = 1000  # landmarks looked at for their errors and for what passes the unary constraints
_NARROWEST = 1e-3  # [m] least extent of a scan
_ALONE = -1  # in place of a neighbour
_FLOOR = 1e-12  # [m²] least variance, as in `located`


@dataclass(frozen=True, slots=True)
class Crowding:
    """What the rule needs to know of a map, for scans of one extent."""

    landmarks: IntArray  # (c + 1,) number of landmarks by the number of others around them
    area: float  # [m²] that these others are counted in
    variance: float  # [m²] per axis, of a landmark relative to those around it

    def starts(self, order: int) -> float:
        """Σ_j λ_j^order [1/m^(2 order)]."""
        others = np.arange(len(self.landmarks), dtype=np.float64)
        mean = float((self.landmarks * others).sum()) / max(int(self.landmarks.sum()), 1)
        falling = np.prod([np.maximum(others - p, 0.0) / self.area for p in range(order)], axis=0)
        return max(float((self.landmarks * falling).sum()), int(self.landmarks.sum()) * (mean / self.area) ** order)


def min_pairings(
    scan: Scan,
    landmarks: Landmarks,
    *,
    confidence: float = 0.99,
    probability: float = 0.02,
    crowding: Crowding | None = None,
) -> int:
    """The least k ≥ 3 such that fewer than `probability` hypotheses of k pairings are expected by chance; ≤ m + 1.

    One more where that explains less than `EXPLAINED` of the scan: see the head of this file. `crowding` is that of the
    map for the extent of the scan, where it is known already. Raises ValueError as `scan_arrays` and `map_arrays` do,
    and unless 0 < probability < 1.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability: {probability} is not between 0 and 1")
    expected = expected_by_chance(scan, landmarks, confidence=confidence, crowding=crowding)
    return with_margin(max(3, int(np.flatnonzero(expected >= probability)[-1]) + 1), len(scan))


def with_margin(pairings: int, measurements: int) -> int:
    """What is asked for where a Poisson process would ask for so many `pairings` of so many `measurements`."""
    return max(pairings, min(pairings + 1, math.ceil(EXPLAINED * measurements)))


def expected_by_chance(
    scan: Scan, landmarks: Landmarks, *, confidence: float = 0.99, crowding: Crowding | None = None
) -> Array:
    """E_k for k = 0 … m, (m + 1,); inf for k < 2, which any pose explains. Raises ValueError as `min_pairings` does."""
    points, noise, m = scan.points, scan.covariances, len(scan)
    fractions = _fractions(scan, landmarks, confidence)
    expected = np.full(m + 1, np.inf)
    if m < 2:
        return expected
    if crowding is None:
        crowding = crowding_of(landmarks, extent(scan))
    areas = _areas(noise, crowding.variance)
    subsets, sigma = _elementary_symmetric(areas * fractions), math.sqrt(float(areas.mean()))
    spread = math.sqrt(float(((points - points.mean(0)) ** 2).sum()) / (m - 1))
    for k in range(2, m + 1):
        pose = k * math.sqrt(k - 1) * spread / sigma**3
        tube = pose * _ball(2 * k - 3, chi2_gate(2 * k - 3, confidence))
        expected[k] = 2.0 * math.pi * crowding.starts(k - 1) * subsets[k] * tube
    return expected


def extent(scan: Scan) -> float:
    """[m] of what a scan covers: twice the largest distance of a measurement from their centre."""
    if not len(scan):
        return _NARROWEST
    return max(2.0 * float(np.sqrt(((scan.points - scan.points.mean(0)) ** 2).sum(1).max())), _NARROWEST)


def crowding_of(landmarks: Landmarks, width: float) -> Crowding:
    """Densities from counts in squares of `width` [m] around each landmark, errors from pairs within a third of that.

    O(n). Raises ValueError as `map_arrays` does.
    """
    mapped = mapped_of(map_arrays(landmarks))
    others, neighbours = _neighbourhoods(mapped.positions, width / 3.0)
    variance = _relative_variance(mapped, neighbours, max(len(landmarks) // _SAMPLE, 1))
    return Crowding(np.bincount(others, minlength=1), width * width, variance)


@functools.lru_cache(maxsize=1024)
def _ball(dimension: int, square: float) -> float:
    """Volume of the ball of radius √square."""
    return math.exp(0.5 * dimension * math.log(math.pi * square) - math.lgamma(0.5 * dimension + 1.0))


def _areas(noise: Array, variance: float) -> Array:
    """a_i (m,) [m²]."""
    xx, yy, xy = noise[:, 0, 0] + variance, noise[:, 1, 1] + variance, noise[:, 0, 1]
    areas: Array = np.sqrt(np.maximum(xx * yy - xy * xy, _FLOOR**2))
    return areas


def _fractions(scan: Scan, landmarks: Landmarks, confidence: float) -> Array:
    """q_i (m,)."""
    _, _, sizes, variances, kinds = scan_arrays(scan)
    _, _, of_sizes, of_variances, of_kinds, *_ = map_arrays(landmarks)
    step, gate = max(len(landmarks) // _SAMPLE, 1), chi2_gate(1, confidence)
    of_sizes, of_variances, of_kinds = of_sizes[::step].copy(), of_variances[::step].copy(), of_kinds[::step].copy()
    passed = unary_table(sizes, variances, kinds, of_sizes, of_variances, of_kinds, gate)
    fractions: Array = passed.sum(axis=1) / max(passed.shape[1], 1)
    return fractions


@compiled
def _elementary_symmetric(values: Array) -> Array:
    """e_0 … e_m of `values` (m,)."""
    sums = np.zeros(len(values) + 1)
    sums[0] = 1.0
    for i in range(len(values)):
        for k in range(i + 1, 0, -1):
            sums[k] += sums[k - 1] * values[i]
    return sums


@compiled
def _neighbourhoods(positions: Array, side: float) -> tuple[IntArray, IntArray]:
    """Number of others in the 3 × 3 cells of `side` around each point (n,); one in its own cell (n,), or _ALONE.

    Cells are hashed into a table, where different ones may meet: that can only make the map look more crowded.
    """
    n, size = len(positions), 64
    while size < 8 * n:
        size *= 2
    counts, last = np.zeros(size, np.int64), np.full(size, _ALONE)
    others, neighbours = np.empty(n, np.int64), np.empty(n, np.int64)
    for j in range(n):
        cell = _cell(math.floor(positions[j, 0] / side), math.floor(positions[j, 1] / side), size)
        counts[cell] += 1
        neighbours[j], last[cell] = last[cell], j
    for j in range(n):
        x, y = math.floor(positions[j, 0] / side), math.floor(positions[j, 1] / side)
        others[j] = -1
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                others[j] += counts[_cell(x + dx, y + dy, size)]
    return others, neighbours


@compiled
def _cell(x: float, y: float, size: int) -> int:
    """Entry of a table of `size`, a power of 2."""
    return int((np.int64(x) * 73856093 ^ np.int64(y) * 19349663) & (size - 1))


@compiled
def _relative_variance(mapped: Mapped, neighbours: IntArray, step: int) -> float:
    """[m²] per axis: half that of the difference to a neighbour, the mean over every `step`-th landmark with one.

    Where none has one, the mean of the marginals.
    """
    positions, covariances = mapped.positions, mapped.covariances
    total, count = 0.0, 0
    for j in range(0, len(positions), step):
        if neighbours[j] != _ALONE:
            xx, _, yy = difference_covariance(mapped, j, neighbours[j])
            total, count = total + 0.25 * max(xx + yy, 0.0), count + 1
    if count == 0:
        for j in range(0, len(positions), step):
            total, count = total + 0.5 * (covariances[j, 0, 0] + covariances[j, 1, 1]), count + 1
    return total / max(count, 1)
