"""Does the filter know how wrong it is? Normalised errors against their χ² law."""

from __future__ import annotations

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import relative, wrap_angle
from slam_gym.mapping import ekf
from slam_gym.types import Array


@compiled
def nees(error: Array, covariance: Array) -> float:
    """Normalised estimation error squared ε = eᵀ P⁻¹ e of an error e (d,) with covariance P (d, d).

    χ² with d degrees of freedom where the filter is consistent. A direction with variance 0 contributes nothing where
    its error is 0 too, as at the robot's first pose, and makes ε infinite otherwise.
    """
    d = len(error)
    factor, y = np.zeros((d, d)), np.zeros(d)  # P = L Lᵀ, y = L⁻¹ e
    total = 0.0
    for i in range(d):
        for j in range(i + 1):
            rest = covariance[i, j]
            for k in range(j):
                rest -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = rest / factor[j, j] if factor[j, j] > 0.0 else 0.0
            elif rest > 1e-15 * covariance[i, i]:
                factor[i, i] = math.sqrt(rest)
        left = error[i]
        for k in range(i):
            left -= factor[i, k] * y[k]
        if factor[i, i] > 0.0:
            y[i] = left / factor[i, i]
            total += y[i] * y[i]
        elif abs(left) > 1e-12:
            return math.inf
    return total


@compiled
def pose_nees(pose: Array, covariance: Array, true: Array) -> float:
    """NEES of a pose (3,) with covariance (3, 3) against the true pose (3,), headings compared around the circle."""
    error = pose - true
    error[2] = wrap_angle(error[2])
    return nees(error, covariance)


@compiled
def error_of_pose(x: Array, P: Array, base: Array, true: Array) -> float:
    """`pose_nees` of the robot in a map of state x and covariance P (upper triangle) with its base (3,) in W, held
    against its true pose (3,) in W."""
    return pose_nees(x[:3], ekf.symmetric(P, 3), relative(base, true))


def anees(values: Array, dof: int) -> float:
    """Average NEES per degree of freedom of values (r,) with `dof` each: 1 where consistent, more where optimistic.

    NaN without values.
    """
    return float(np.mean(values)) / dof if len(values) else math.nan
