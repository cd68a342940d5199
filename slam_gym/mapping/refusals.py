"""What a stochastic map refuses, and how it says so."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.geometry import wrap_angle
from slam_gym.mapping.linear_algebra import is_covariance
from slam_gym.mapping.update import NO_SUCH_FEATURE
from slam_gym.types import Array, IntArray, Scan


def checked_pose(pose: ArrayLike, covariance: ArrayLike) -> tuple[Array, Array]:
    """Fresh arrays (3,), its heading wrapped, and (3, 3)."""
    x, P = np.array(pose, dtype=np.float64), np.array(covariance, dtype=np.float64)
    if x.shape != (3,) or not np.all(np.isfinite(x)):
        raise ValueError(f"pose: expected 3 finite numbers, got {x.tolist()}")
    if P.shape != (3, 3) or not is_covariance(P):
        raise ValueError(f"pose_covariance: not a 3 x 3 covariance: {P.tolist()}")
    x[2] = wrap_angle(x[2])
    return x, P


def existing(features: IntArray, n: int) -> IntArray:
    """`features` (k,), in one block of memory, once they all exist in a map of n features."""
    features = np.ascontiguousarray(features, dtype=np.int64)
    if np.any((features < 0) | (features >= n)):
        raise ValueError(f"features: {features.tolist()} do not all exist in a map of {n} features")
    return features


def refused_update(refused: int, scan: Scan, features: IntArray, n: int) -> ValueError:
    """Why an update of a map of n features with these pairings was `refused` (see `mapping.update`)."""
    if refused == NO_SUCH_FEATURE:
        return ValueError(f"features: {features.tolist()} for a map of {n} features")
    if refused == len(scan):
        return ValueError("the innovation covariance is singular to working precision")
    return bad_measurement(scan, refused)


def bad_measurement(scan: Scan, i: int) -> ValueError:
    """That measurement i can neither update nor start a feature."""
    return ValueError(
        f"scan: measurement {i} is not finite, or its covariance is none: "
        f"point {scan.points[i].tolist()}, covariance {scan.covariances[i].tolist()}"
    )
