"""Refuse numbers that would corrupt a map, by name, before they reach it."""

from __future__ import annotations

import math

import numpy as np

from slam_gym._compile import compiled
from slam_gym.types import Array, Odometry, Scan

_PSD_TOLERANCE = 1e-9  # relative to the largest eigenvalue


@compiled
def _first_bad_measurement(points: Array, covariances: Array, tolerance: float) -> tuple[int, int]:
    """(measurement, fault): 1 non-finite point, 2 non-finite covariance, 3 asymmetric, 4 not PSD; (−1, 0) if fine."""
    for i in range(points.shape[0]):
        if not (math.isfinite(points[i, 0]) and math.isfinite(points[i, 1])):
            return i, 1
        a, b, c, d = covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 1, 0], covariances[i, 1, 1]
        if not (math.isfinite(a) and math.isfinite(b) and math.isfinite(c) and math.isfinite(d)):
            return i, 2
        scale = abs(a) + abs(d)
        if abs(b - c) > tolerance * scale:
            return i, 3
        if a < 0.0 or d < 0.0 or a * d - b * c < -tolerance * scale * scale or (scale == 0.0 and b != 0.0):
            return i, 4
    return -1, 0


_FAULTS = ("", "points are not finite", "covariance is not finite", "covariance is not symmetric", "covariance is not PSD")


def check_scan(scan: Scan) -> None:
    """Raise ValueError naming the field and the first bad measurement of a scan."""
    m = len(scan.points)
    if scan.points.shape != (m, 2):
        raise ValueError(f"Scan.points: shape {scan.points.shape}, expected (m, 2)")
    if scan.covariances.shape != (m, 2, 2):
        raise ValueError(f"Scan.covariances: shape {scan.covariances.shape}, expected ({m}, 2, 2)")
    if scan.sizes.shape != (m,) or scan.size_variances.shape != (m,):
        raise ValueError(f"Scan.sizes, Scan.size_variances: shapes {scan.sizes.shape}, {scan.size_variances.shape}")
    index, fault = _first_bad_measurement(scan.points, scan.covariances, _PSD_TOLERANCE)
    if fault:
        raise ValueError(f"Scan: measurement {index}: {_FAULTS[fault]}")


@compiled
def _odometry_fault(motion: Array, covariance: Array, tolerance: float) -> int:
    """0 fine, 1 motion not finite, 2 covariance not finite, 3 asymmetric, 4 not PSD (by pivoted elimination)."""
    for i in range(3):
        if not math.isfinite(motion[i]):
            return 1
    scale = 0.0
    for i in range(3):
        for j in range(3):
            if not math.isfinite(covariance[i, j]):
                return 2
        scale += abs(covariance[i, i])
    work = covariance.copy()
    for i in range(3):
        for j in range(i):
            if abs(work[i, j] - work[j, i]) > tolerance * scale:
                return 3
    for _ in range(3):
        p = 0
        for i in range(1, 3):
            if work[i, i] > work[p, p]:
                p = i
        for i in range(3):
            if work[i, i] < -tolerance * scale:
                return 4
        pivot = work[p, p]
        if pivot <= tolerance * scale:
            for i in range(3):
                for j in range(3):
                    if abs(work[i, j]) > math.sqrt(tolerance) * scale:
                        return 4
            return 0
        column = work[:, p].copy()
        for i in range(3):
            for j in range(3):
                work[i, j] -= column[i] * column[j] / pivot
        work[p, :] = 0.0
        work[:, p] = 0.0
    return 0


_ODOMETRY_FAULTS = (
    "",
    "motion is not finite",
    "covariance is not finite",
    "covariance is not symmetric",
    "covariance is not PSD",
)


def check_odometry(odometry: Odometry) -> None:
    """Raise ValueError naming the bad field of an odometry reading."""
    if np.shape(odometry.motion) != (3,) or np.shape(odometry.covariance) != (3, 3):
        shapes = f"{np.shape(odometry.motion)}, {np.shape(odometry.covariance)}"
        raise ValueError(f"Odometry.motion, Odometry.covariance: shapes {shapes}, expected (3,), (3, 3)")
    fault = _odometry_fault(odometry.motion, odometry.covariance, _PSD_TOLERANCE)
    if fault:
        raise ValueError(f"Odometry: {_ODOMETRY_FAULTS[fault]}")
