"""Checked scans and maps as plain arrays, in the types for which the searches without a prior are compiled."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from slam_gym.types import Array, IntArray, Landmarks, Locality, Scan, ScanArrays
from slam_gym.types._fields import compact
from slam_gym.validation import check_scan

_TOLERANCE = 1e-9  # of a negative determinant, relative to the product of the variances


class Mapped(NamedTuple):
    """The arrays of a map."""

    positions: Array  # (n, 2) [m] in B
    covariances: Array  # (n, 2, 2) [m²]
    sizes: Array  # (n,) [m], NaN where unknown
    size_variances: Array  # (n,) [m²]
    kinds: IntArray  # (n,)
    covariance: Array  # (2n, 2n) [m²] or (0, 0)
    block_starts: IntArray  # (n + 1,) or (0,)
    block_columns: IntArray  # (e,)
    blocks: Array  # (e, 2, 2) [m²]


def scan_arrays(scan: Scan) -> ScanArrays:
    """The arrays of a scan. Raises ValueError naming a field and measurement not finite or not a covariance."""
    check_scan(scan)
    if np.any(scan.size_variances < 0.0):
        raise ValueError(f"Scan.size_variances: measurement {int(np.argmax(scan.size_variances < 0.0))}: negative")
    points, noise = compact(scan.points), compact(scan.covariances)
    return points, noise, compact(scan.sizes), compact(scan.size_variances), compact(scan.kinds)


def map_arrays(landmarks: Landmarks) -> Mapped:
    """The arrays of a map. Raises ValueError naming a field of the wrong shape, not finite, or not a covariance.

    The entries of the joint covariance are not checked: with 1 000 features this would cost more than the search.
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
    starts = landmarks.block_starts
    if len(starts) not in (0, n + 1) or (len(starts) and starts[-1] != e):
        raise ValueError(f"Landmarks.block_starts: does not delimit {e} blocks of {n} features")
    (a, b), (_, d) = landmarks.covariances.transpose(1, 2, 0)
    with np.errstate(invalid="ignore"):
        psd = (a >= 0.0) & (d >= 0.0) & (a * d - b * b >= -_TOLERANCE * a * d) & np.isfinite(a + d)
    for name, is_fault, fault in (
        ("positions", ~np.isfinite(landmarks.positions).all(axis=1), "not finite"),
        ("covariances", ~psd, "not PSD"),
        ("size_variances", landmarks.size_variances < 0.0, "negative"),
    ):
        if is_fault.any():
            raise ValueError(f"Landmarks.{name}[{is_fault.argmax()}] is {fault}")
    return unchecked_map(landmarks)


def unchecked_map(landmarks: Landmarks) -> Mapped:
    """The arrays of a map, unchecked."""
    fields: list[Any] = [getattr(landmarks, name) for name in Mapped._fields]
    types = (np.int64 if field.dtype.kind == "i" else np.float64 for field in fields)
    return Mapped(*[compact(field.astype(dtype, copy=False)) for field, dtype in zip(fields, types)])


def locality_arrays(locality: Locality | None, n: int) -> tuple[IntArray, IntArray]:
    """Starts and members; both empty for None. Raises ValueError unless the locality is one of n features."""
    if locality is None:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    starts, members = compact(locality.starts), compact(locality.members)
    if len(starts) != n + 1 or starts[0] != 0 or starts[-1] != len(members) or np.any(starts[1:] < starts[:-1]):
        raise ValueError(f"Locality.starts: does not delimit {len(members)} members of {n} features")
    if len(members) and not (members.min() >= 0 and members.max() < n):
        raise ValueError(f"Locality.members: {members.min()} to {members.max()} for {n} features")
    return starts, members
