"""What goes into and comes out of the kernels of a `FeatureIndex`, in Python's terms."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.triangles.map import first_bad_feature
from slam_gym.association.triangles.verify import BINARY, JOINT, LEAVES, LIMIT, NODES, TRIES
from slam_gym.geometry import wrap_angle
from slam_gym.types import UNKNOWN_KIND, Array, Effort, IntArray, Scan


def check_features(positions: Array, covariances: Array) -> None:
    if covariances.shape != (len(positions), 2, 2):
        raise ValueError(f"covariances: shape {covariances.shape}, expected ({len(positions)}, 2, 2)")
    j, fault = first_bad_feature(positions, covariances)
    if fault == 1:
        raise ValueError(f"positions: feature {j} is not finite: {positions[j].tolist()}")
    if fault == 2:
        raise ValueError(f"covariances: that of feature {j} is not PSD: {covariances[j].tolist()}")


def effort_of(spent: IntArray, truncated: bool, seconds: float) -> Effort:
    return Effort(
        nodes=int(spent[NODES]),
        binary_tests=int(spent[BINARY]),
        joint_tests=int(spent[JOINT]),
        leaves=int(spent[LEAVES]),
        tries=int(spent[TRIES]),
        limit_hit=bool(spent[LIMIT]) or truncated,
        seconds=seconds,
    )


def kinds_as_numbers(kinds: ArrayLike | None) -> Array | float:
    """Kinds as numbers, NaN for UNKNOWN_KIND."""
    if kinds is None:
        return math.nan
    return np.where(np.equal(kinds, UNKNOWN_KIND), math.nan, kinds)


def attributes_of(scan: Scan) -> Array:
    """Size [m], its variance [m²] and kind (m, 3) of each measurement, NaN where unknown."""
    return np.column_stack([scan.sizes, scan.size_variances, kinds_as_numbers(scan.kinds)])


@functools.lru_cache(maxsize=1024)
def search_gates(m: int, confidence: float) -> Array:
    """χ²_1, χ²_2, then χ²_{2k−3} for k = 2 … m; shared, not to be written to."""
    return np.array(
        [chi2_gate(1, confidence), chi2_gate(2, confidence)]
        + [chi2_gate(2 * k - 3, confidence) for k in range(2, m + 1)]
    )


def pose_of(fit: Array) -> tuple[Array, Array]:
    """Pose of the robot (3,) and its covariance (3, 3), from a fit of `index_pose`."""
    tx, ty, c, s, ox, oy, xx, xy, yy, xt, yt, tt = fit.tolist()
    jx, jy = s * ox + c * oy, s * oy - c * ox
    pose = np.array([tx - c * ox + s * oy, ty - s * ox - c * oy, wrap_angle(math.atan2(s, c))])
    pxt, pyt = xt + jx * tt, yt + jy * tt
    pxx, pyy = xx + 2.0 * jx * xt + jx * jx * tt, yy + 2.0 * jy * yt + jy * jy * tt
    pxy = xy + jx * yt + jy * xt + jx * jy * tt
    return pose, np.array([[pxx, pxy, pxt], [pxy, pyy, pyt], [pxt, pyt, tt]])
