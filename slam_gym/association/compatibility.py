"""Compatibility: which pairings of a measurement with a mapped feature are worth considering at all.

With innovation ν_ij = z_i − h_j(x) and S_ij = H_j P H_jᵀ + R_i, measurement i and feature j are **individually
compatible** when D²_ij = ν_ijᵀ S_ij⁻¹ ν_ij < χ²_{2,conf}. A hypothesis H is **jointly compatible** when the same holds
of all its pairings stacked, with full cross-covariances: D²_H = ν_Hᵀ S_H⁻¹ ν_H < χ²_{2|H|,conf} (Neira and Tardós,
"Data association in stochastic mapping using the joint compatibility test", IEEE TRA 17(6), 2001).
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from slam_gym._jit import compiled
from slam_gym.association.prediction import Prediction
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray, Scan

Entry = TypeVar("Entry", bound=np.generic)

_FAULTS = (
    "",
    "scan.points[{}] is not finite",
    "scan.covariances[{}] is not positive semi-definite",
    "prediction.positions[{}] is not finite",
    "prediction.covariances[{}] has a variance that is negative or not finite",
    "scan.covariances[{}] leaves the innovation covariance singular",
)
_EVERY_ROW = np.empty(0, np.bool_)


class Candidates(NamedTuple):
    """Individually compatible pairings, gathered by measurement (compressed rows), by ascending D² within each.

    Those of `measurements[i]` are entries `starts[i]:starts[i + 1]` of the arrays (c,).
    """

    measurements: IntArray  # (l,) the measurements that were offered features
    starts: IntArray  # (l + 1,)
    measured: IntArray  # (c,) measurement of the pairing
    slots: IntArray  # (c,) its feature, as an index into `rows`
    distances: Array  # (c,) D²_ij
    innovations: Array  # (c, 2) [m] ν_ij in R
    rows: IntArray  # (u,) the distinct rows of the prediction among them, ascending
    tests: int  # pairings tested


@functools.lru_cache(maxsize=1024)
def chi2_gate(dof: int, confidence: float) -> float:
    """χ²_{dof,conf}: what χ² with `dof` degrees of freedom stays below with probability `confidence`.

    Raises ValueError unless dof ≥ 1 and 0 < confidence < 1.
    """
    if dof < 1:
        raise ValueError(f"dof: {dof} is less than 1")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: {confidence} is not between 0 and 1")
    return float(chdtri(dof, 1.0 - confidence))


@functools.lru_cache(maxsize=1024)
def joint_gates(pairings: int, confidence: float) -> Array:
    """χ²_{2p,conf} for p = 0 … pairings, (pairings + 1,); 0 for p = 0. Shared: not to be written to."""
    return np.array([0.0] + [chi2_gate(2 * p, confidence) for p in range(1, pairings + 1)])


class JointDistance(NamedTuple):
    """Of all pairings of a hypothesis together."""

    squared: float  # D²_H
    dof: int  # 2 per pairing


class _Gated(NamedTuple):
    """What gating comes to."""

    fault: int  # index into _FAULTS
    where: int  # entry at fault
    starts: IntArray  # from here on as in `Candidates`
    measured: IntArray
    slots: IntArray
    distances: Array
    innovations: Array
    rows: IntArray
    tests: int


def plain(array: NDArray[Entry]) -> NDArray[Entry]:
    """The array itself, or a view that compiled functions take for it where it is marked read-only.

    They are compiled anew for read-only arrays, and write to none of their arguments.
    """
    if array.flags.writeable:
        return array
    view = array.view()
    try:
        view.flags.writeable = True
    except ValueError:  # its memory cannot be written to
        return array.copy()
    return view


def individual(
    scan: Scan,
    prediction: Prediction,
    confidence: float | None = None,
    *,
    measurements: IntArray | None = None,
    eligible: BoolArray | None = None,
) -> Candidates:
    """All individually compatible pairings of `measurements` (default: all) with the rows where `eligible` (k,) holds.

    The gate's confidence is the prediction's unless another is given. Raises ValueError naming the field and entry that
    is not finite, or a covariance that is none.
    """
    if measurements is None:
        measurements = np.arange(len(scan.points))
    gated = _Gated(
        *gate_pairings(
            plain(scan.points),
            plain(scan.covariances),
            plain(prediction.positions),
            plain(prediction.covariances),
            measurements,
            _EVERY_ROW if eligible is None else plain(eligible),
            chi2_gate(2, prediction.confidence if confidence is None else confidence),
        )
    )
    check_fault(gated.fault, gated.where)
    return Candidates(measurements, *gated[2:])


def check_fault(fault: int, entry: int) -> None:
    """Raise ValueError naming what is not finite, or is no covariance, where a compiled search reports a fault."""
    if fault:
        raise ValueError(_FAULTS[fault].format(entry))


def joint_distance(scan: Scan, prediction: Prediction, rows: IntArray) -> JointDistance:
    """D²_H of the hypothesis that pairs measurement i with row rows[i] (m,), or UNPAIRED.

    Raises ValueError where S_H is not positive definite.
    """
    chosen = paired_rows(rows)
    dof = 2 * len(chosen)
    if not dof:
        return JointDistance(0.0, 0)
    joint = prediction.joint(chosen)
    squared = distance_of(plain(scan.points), plain(scan.covariances), plain(prediction.positions), rows, plain(joint))
    if math.isnan(squared):
        raise ValueError(f"innovation covariance of the pairings {rows.tolist()} is not positive definite")
    return JointDistance(squared, dof)


@compiled
def paired_rows(rows: IntArray) -> IntArray:
    """The rows that are not UNPAIRED."""
    chosen, count = np.empty(len(rows), np.int64), 0
    for row in rows:
        if row != UNPAIRED:
            chosen[count] = row
            count += 1
    return chosen[:count]


@compiled
def distance_of(points: Array, noise: Array, positions: Array, rows: IntArray, joint: Array) -> float:
    """νᵀ S⁻¹ ν = yᵀy with y = L⁻¹ν, S = L Lᵀ; NaN where S is not positive definite."""
    L, y, p = joint.copy(), np.empty(len(joint)), 0
    for i in range(len(rows)):
        if rows[i] >= 0:
            for a in range(2):
                y[2 * p + a] = points[i, a] - positions[rows[i], a]
                for b in range(2):
                    L[2 * p + a, 2 * p + b] += noise[i, a, b]
            p += 1
    squared = 0.0
    for a in range(len(L)):
        for b in range(a + 1):
            for k in range(b):
                L[a, b] -= L[a, k] * L[b, k]
            if b < a:
                L[a, b] /= L[b, b]
                y[a] -= L[a, b] * y[b]
        if not L[a, a] > 0.0:
            return math.nan
        L[a, a] = math.sqrt(L[a, a])
        y[a] /= L[a, a]
        squared += y[a] * y[a]
    return squared


@compiled
def _bad_measurement(points: Array, noise: Array) -> tuple[int, int]:
    """(index into _FAULTS, entry) of the first bad number; (0, −1) where all are good."""
    for i in range(points.shape[0]):
        if not math.isfinite(points[i, 0] + points[i, 1]):
            return 1, i
        a, b, d = noise[i, 0, 0], noise[i, 0, 1], noise[i, 1, 1]
        if not (a >= 0.0 and d >= 0.0 and a * d - b * b >= -1e-9 * a * d and math.isfinite(a + d)):
            return 2, i
    return 0, -1


@compiled
def gate_pairings(
    points: Array,
    noise: Array,
    positions: Array,
    covariances: Array,
    measurements: IntArray,
    eligible: BoolArray,
    gate: float,
) -> tuple[int, int, IntArray, IntArray, IntArray, Array, Array, IntArray, int]:
    """`_Gated`, as a plain tuple."""
    fault, where = _bad_measurement(points, noise)
    offered, bad_feature, entry = _offered(points, noise, positions, covariances, measurements, eligible, gate)
    if fault == 0 and bad_feature > 0:
        fault, where = bad_feature, entry
    count, room = 0, len(measurements) * len(offered)
    starts, measured = np.zeros(len(measurements) + 1, np.int64), np.empty(room, np.int64)
    slots, distances, innovations = np.empty(room, np.int64), np.empty(room), np.empty((room, 2))
    for level in range(len(measurements) if fault == 0 else 0):
        i = measurements[level]
        for o in range(len(offered)):
            j = offered[o]
            x, y = points[i, 0] - positions[j, 0], points[i, 1] - positions[j, 1]
            xx, yy = covariances[j, 0, 0] + noise[i, 0, 0], covariances[j, 1, 1] + noise[i, 1, 1]
            # D² ≥ ν_x² / S_xx and likewise in y: this settles most pairings
            if x * x >= gate * xx or y * y >= gate * yy:
                continue
            xy = covariances[j, 0, 1] + noise[i, 0, 1]
            determinant = xx * yy - xy * xy
            if not determinant > 0.0:
                fault, where = 5, i
                continue
            distance = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant
            if not distance < gate:
                continue
            place = count
            while place > starts[level] and distances[place - 1] > distance:
                slots[place], distances[place] = slots[place - 1], distances[place - 1]
                innovations[place, 0], innovations[place, 1] = innovations[place - 1, 0], innovations[place - 1, 1]
                place -= 1
            measured[count], slots[place], distances[place] = i, o, distance
            innovations[place, 0], innovations[place, 1] = x, y
            count += 1
        starts[level + 1] = count
    rows = offered[_number_distinct(slots[:count], len(offered))]
    tests = len(measurements) * len(offered)
    return fault, where, starts, measured[:count], slots[:count], distances[:count], innovations[:count], rows, tests


@compiled
def _offered(
    points: Array,
    noise: Array,
    positions: Array,
    covariances: Array,
    measurements: IntArray,
    eligible: BoolArray,
    gate: float,
) -> tuple[IntArray, int, int]:
    """Eligible rows whose gate reaches into the box around the measurements: the others are compatible with none.

    An empty `eligible` stands for all rows. Then the first bad number of all features, as in `_bad_measurement`.
    """
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
            return offered[:0], 3, j
        if not (0.0 <= xx < math.inf and 0.0 <= yy < math.inf):
            return offered[:0], 4, j
        if len(eligible) > 0 and not eligible[j]:
            continue
        x, y = max(left - px, px - right, 0.0), max(bottom - py, py - top, 0.0)
        if x * x < gate * (xx + most_x) and y * y < gate * (yy + most_y):
            offered[count] = j
            count += 1
    return offered[:count], 0, -1


@compiled
def _number_distinct(values: IntArray, bound: int) -> IntArray:
    """The distinct values (all in 0 … bound − 1), ascending; each value is replaced by its index among them."""
    number, count = np.zeros(bound, np.int64), 0
    for value in values:
        number[value] = 1
    distinct = np.empty(min(bound, len(values)), np.int64)
    for value in range(bound):
        if number[value] == 1:
            distinct[count], number[value] = value, count
            count += 1
    for i in range(len(values)):
        values[i] = number[values[i]]
    return distinct[:count]
