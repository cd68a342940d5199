"""Scans and maps as plain arrays, checked, in the form that the compiled searches without a prior were compiled for."""

from __future__ import annotations

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import plain
from slam_gym.types import Array, IntArray, Landmarks, Locality, Scan
from slam_gym.validation import check_scan

_TOLERANCE = 1e-9  # of a negative determinant, relative to the variances' product

_FAULTS = (
    "",
    "positions[{}] is not finite",
    "covariances[{}] is not finite",
    "covariances[{}] is not PSD",
    "size_variances[{}] is negative",
)

ScanArrays = tuple[Array, Array, Array, Array, IntArray]
MapArrays = tuple[Array, Array, Array, Array, IntArray, Array, IntArray, IntArray, Array]


def scan_arrays(scan: Scan) -> ScanArrays:
    """Points, noise, sizes, size variances and kinds (all UNKNOWN_KIND where there are none), fit for kernels.

    Raises ValueError naming the field and measurement that is not finite, or no covariance.
    """
    check_scan(scan)
    m = len(scan)
    kinds = integers(scan.kinds)
    if kinds.shape != (m,):
        raise ValueError(f"Scan.kinds: shape {kinds.shape}, expected ({m},)")
    if np.any(scan.size_variances < 0.0):
        raise ValueError(f"Scan.size_variances: measurement {int(np.argmax(scan.size_variances < 0.0))}: negative")
    return floats(scan.points), floats(scan.covariances), floats(scan.sizes), floats(scan.size_variances), kinds


def map_arrays(landmarks: Landmarks) -> MapArrays:
    """Positions, covariances, sizes, size variances, kinds, covariance and the three of the blocks, fit for kernels.

    Raises ValueError naming the field of a wrong shape, or that holds what is not finite or no covariance. The joint
    covariance is not looked through: at 1 000 features that would cost more than the search.
    """
    n, e = len(landmarks.positions), len(landmarks.blocks)
    shapes = {
        "positions": (n, 2),
        "covariances": (n, 2, 2),
        "sizes": (n,),
        "size_variances": (n,),
        "kinds": (n,),
        "blocks": (e, 2, 2),
        "block_columns": (e,),
    }
    for name, shape in shapes.items():
        if getattr(landmarks, name).shape != shape:
            raise ValueError(f"Landmarks.{name}: shape {getattr(landmarks, name).shape}, expected {shape}")
    if landmarks.covariance.shape not in ((2 * n, 2 * n), (0, 0)):
        raise ValueError(f"Landmarks.covariance: shape {landmarks.covariance.shape}, expected {(2 * n, 2 * n)}")
    if len(landmarks.block_starts) not in (0, n + 1) or (
        len(landmarks.block_starts) and landmarks.block_starts[-1] != e
    ):
        raise ValueError(f"Landmarks.block_starts: does not delimit {e} blocks of {n} features")
    arrays = (
        floats(landmarks.positions),
        floats(landmarks.covariances),
        floats(landmarks.sizes),
        floats(landmarks.size_variances),
        integers(landmarks.kinds),
        floats(landmarks.covariance),
        integers(landmarks.block_starts),
        integers(landmarks.block_columns),
        floats(landmarks.blocks),
    )
    fault, where = _first_bad_feature(arrays[0], arrays[1], arrays[3])
    if fault:
        raise ValueError(f"Landmarks.{_FAULTS[fault].format(where)}")
    return arrays


def locality_arrays(locality: Locality | None, n: int) -> tuple[IntArray, IntArray]:
    """Starts and members; both empty where there is none. Raises ValueError where it is not one of n features."""
    if locality is None:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    starts, members = integers(locality.starts), integers(locality.members)
    if len(starts) != n + 1 or starts[0] != 0 or starts[-1] != len(members) or np.any(starts[1:] < starts[:-1]):
        raise ValueError(f"Locality.starts: does not delimit {len(members)} members of {n} features")
    if len(members) and not (members.min() >= 0 and members.max() < n):
        raise ValueError(f"Locality.members: {members.min()} to {members.max()} for {n} features")
    return starts, members


def floats(array: Array) -> Array:
    """As the kernels were compiled for: float64, C-contiguous, not marked read-only."""
    return plain(np.ascontiguousarray(array, np.float64))


def integers(array: IntArray) -> IntArray:
    """The same for int64."""
    return plain(np.ascontiguousarray(array, np.int64))


@compiled
def _first_bad_feature(positions: Array, covariances: Array, size_variances: Array) -> tuple[int, int]:
    """(index into _FAULTS, feature) of the first bad number; (0, −1) where all are good."""
    for j in range(len(positions)):
        if not math.isfinite(positions[j, 0] + positions[j, 1]):
            return 1, j
        a, b, d = covariances[j, 0, 0], covariances[j, 0, 1], covariances[j, 1, 1]
        if not math.isfinite(a + b + d):
            return 2, j
        if a < 0.0 or d < 0.0 or a * d - b * b < -_TOLERANCE * a * d:
            return 3, j
        if size_variances[j] < 0.0:
            return 4, j
    return 0, -1
