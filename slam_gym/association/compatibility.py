"""Compatibility tests: which pairings of a measurement with a mapped feature are plausible.

With innovation ν_ij = z_i − h_j(x) and S_ij = H_j P H_jᵀ + R_i, measurement i and feature j are **individually
compatible** when D²_ij = ν_ijᵀ S_ij⁻¹ ν_ij < χ²_{2,conf}. A hypothesis H is **jointly compatible** when the stacked
innovations of all its pairings, with full cross-covariances, satisfy D²_H = ν_Hᵀ S_H⁻¹ ν_H < χ²_{2|H|,conf} (Neira and
Tardós, "Data association in stochastic mapping using the joint compatibility test", IEEE TRA 17(6), 2001).
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from slam_gym._jit import compiled
from slam_gym.association.prediction import Prediction
from slam_gym.types import Array, BoolArray, IntArray, Scan

Gaussians = tuple[Array, Array]
"""Positions (n, 2) [m] and covariances (n, 2, 2) [m²] in R, of measurements or of predicted features."""


class Candidates(NamedTuple):
    """Individually compatible pairings, grouped by measurement (compressed rows), by ascending D² within each group.

    The pairings of `measurements[i]` are entries `starts[i]:starts[i + 1]` of the arrays (c,).
    """

    measurements: IntArray  # (l,) the measurements that were considered
    starts: IntArray  # (l + 1,)
    measured: IntArray  # (c,) measurement of the pairing
    slots: IntArray  # (c,) its feature, as an index into `rows`
    distances: Array  # (c,) D²_ij
    innovations: Array  # (c, 2) [m] ν_ij in R
    rows: IntArray  # (u,) the distinct rows of the prediction that occur, ascending
    tests: int  # pairings tested


@functools.lru_cache(maxsize=1024)
def chi2_gate(dof: int, confidence: float) -> float:
    """χ²_{dof,conf}: the quantile of χ² with `dof` degrees of freedom at probability `confidence`.

    Raises ValueError unless dof ≥ 1 and 0 < confidence < 1.
    """
    if dof < 1:
        raise ValueError(f"dof: {dof} is less than 1")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: {confidence} is not between 0 and 1")
    return float(chdtri(dof, 1.0 - confidence))


@functools.lru_cache(maxsize=1024)
def joint_gates(pairings: int, confidence: float) -> Array:
    """χ²_{2p,conf} for p = 0 … pairings, (pairings + 1,); 0 for p = 0. The array is cached: do not write to it."""
    return np.array([0.0] + [chi2_gate(2 * p, confidence) for p in range(1, pairings + 1)])


def individual(
    scan: Scan,
    prediction: Prediction,
    confidence: float | None = None,
    *,
    measurements: IntArray | None = None,
) -> Candidates:
    """All individually compatible pairings of `measurements` (default: all) with the rows of the prediction.

    The gate uses the confidence of the prediction unless another is given. Raises ValueError naming the field and entry
    that is not finite or not a covariance.
    """
    if measurements is None:
        measurements = np.arange(len(scan.points))
    gate = chi2_gate(2, prediction.confidence if confidence is None else confidence)
    predicted, every_row = (prediction.expected.positions, prediction.expected.covariances), np.empty(0, np.bool_)
    return gate_pairings(scan.arrays[:2], predicted, measurements, every_row, gate, len(prediction))


@compiled
def gate_pairings(
    scan: Gaussians, predicted: Gaussians, measurements: IntArray, eligible: BoolArray, gate: float, most: int
) -> Candidates:
    """`individual` for eligible rows (k,), or all if (0,), with the `most` nearest of each measurement."""
    (points, noise), (positions, covariances) = scan, predicted
    offered = _offered(scan, predicted, measurements, eligible, gate)
    count, capacity = 0, len(measurements) * len(offered)
    starts, measured = np.zeros(len(measurements) + 1, np.int64), np.empty(capacity, np.int64)
    slots, distances, innovations = np.empty(capacity, np.int64), np.empty(capacity), np.empty((capacity, 2))
    for level in range(len(measurements)):
        i = measurements[level]
        for o in range(len(offered)):
            j = offered[o]
            x, y = points[i, 0] - positions[j, 0], points[i, 1] - positions[j, 1]
            xx, yy = covariances[j, 0, 0] + noise[i, 0, 0], covariances[j, 1, 1] + noise[i, 1, 1]
            # D² ≥ ν_x² / S_xx and likewise in y: this settles most pairings; exact ones go on to the error below
            if x * x > gate * xx or y * y > gate * yy:
                continue
            xy = covariances[j, 0, 1] + noise[i, 0, 1]
            determinant = xx * yy - xy * xy
            if not determinant > 0.0:
                raise ValueError(f"scan.covariances[{i}] leaves the innovation covariance singular")
            distance = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant
            if not distance < gate:
                continue
            if count - starts[level] == most:  # drop the farthest, which may be this one
                if distances[count - 1] <= distance:
                    continue
                count -= 1
            place = count
            while place > starts[level] and distances[place - 1] > distance:
                slots[place], distances[place] = slots[place - 1], distances[place - 1]
                innovations[place, 0], innovations[place, 1] = innovations[place - 1, 0], innovations[place - 1, 1]
                place -= 1
            measured[count], slots[place], distances[place] = i, o, distance
            innovations[place, 0], innovations[place, 1] = x, y
            count += 1
        starts[level + 1] = count
    # the rows that occur, ascending, and the index of each among them
    rows, number, distinct = np.empty(len(offered), np.int64), np.full(len(offered), -1), 0
    for c in range(count):
        number[slots[c]] = 0
    for o in range(len(offered)):
        if number[o] == 0:
            rows[distinct], number[o] = offered[o], distinct
            distinct += 1
    for c in range(count):
        slots[c] = number[slots[c]]
    return Candidates(
        measurements, starts, measured[:count], slots[:count], distances[:count], innovations[:count], rows[:distinct],
        capacity,
    )  # fmt: skip


@compiled
def _offered(
    scan: Gaussians, predicted: Gaussians, measurements: IntArray, eligible: BoolArray, gate: float
) -> IntArray:
    """The eligible rows whose gate reaches into the bounding box of the measurements; no other row is compatible.

    Raises ValueError for the first invalid number of a measurement or feature, even of one that is not considered.
    """
    (points, noise), (positions, covariances) = scan, predicted
    for i in range(len(points)):
        if not math.isfinite(points[i, 0] + points[i, 1]):
            raise ValueError(f"scan.points[{i}] is not finite")
        a, b, d = noise[i, 0, 0], noise[i, 0, 1], noise[i, 1, 1]
        if not (a >= 0.0 and d >= 0.0 and a * d - b * b >= -1e-9 * a * d and math.isfinite(a + d)):
            raise ValueError(f"scan.covariances[{i}] is not positive semi-definite")
    left, right, bottom, top = math.inf, -math.inf, math.inf, -math.inf
    most_x, most_y = 0.0, 0.0
    for i in measurements:
        left, right = min(left, points[i, 0]), max(right, points[i, 0])
        bottom, top = min(bottom, points[i, 1]), max(top, points[i, 1])
        most_x, most_y = max(most_x, noise[i, 0, 0]), max(most_y, noise[i, 1, 1])
    offered, count = np.empty(len(positions), np.int64), 0
    for j in range(len(positions)):
        px, py, xx, yy = positions[j, 0], positions[j, 1], covariances[j, 0, 0], covariances[j, 1, 1]
        if not math.isfinite(px + py):
            raise ValueError(f"prediction.positions[{j}] is not finite")
        if not (0.0 <= xx < math.inf and 0.0 <= yy < math.inf):
            raise ValueError(f"prediction.covariances[{j}] has a variance that is negative or not finite")
        if len(eligible) > 0 and not eligible[j]:
            continue
        x, y = max(left - px, px - right, 0.0), max(bottom - py, py - top, 0.0)
        if x * x <= gate * (xx + most_x) and y * y <= gate * (yy + most_y):
            offered[count] = j
            count += 1
    return offered[:count]
