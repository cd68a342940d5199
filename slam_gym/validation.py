"""Refuse by name what would do harm further in: scans that would corrupt a map, arguments that nobody knows."""

from __future__ import annotations

import math
from typing import Any

from slam_gym._compile import compiled
from slam_gym.types import Array, Scan

_TOLERANCE = 1e-9  # of asymmetry, relative to the trace; of a negative determinant, to the variances' product


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
        if a < 0.0 or d < 0.0 or a * d - b * b < -tolerance * a * d:
            return i, 4
    return -1, 0


_FAULTS = (
    "",
    "points are not finite",
    "covariance is not finite",
    "covariance is not symmetric",
    "covariance is not PSD",
)


def check_scan(scan: Scan) -> None:
    """Raise ValueError naming the field and the first bad measurement of a scan."""
    m = len(scan.points)
    if scan.points.shape != (m, 2):
        raise ValueError(f"Scan.points: shape {scan.points.shape}, expected (m, 2)")
    if scan.covariances.shape != (m, 2, 2):
        raise ValueError(f"Scan.covariances: shape {scan.covariances.shape}, expected ({m}, 2, 2)")
    if scan.sizes.shape != (m,) or scan.size_variances.shape != (m,):
        raise ValueError(f"Scan.sizes, Scan.size_variances: shapes {scan.sizes.shape}, {scan.size_variances.shape}")
    index, fault = _first_bad_measurement(scan.points, scan.covariances, _TOLERANCE)
    if fault:
        raise ValueError(f"Scan: measurement {index}: {_FAULTS[fault]}")


def one_of(name: str, value: Any, known: Any) -> None:
    """Raise ValueError, listing the known values of an argument, where `value` is none of them."""
    if value not in known:
        raise ValueError(f"{name}={value!r}; known: {', '.join(map(str, known))}")
