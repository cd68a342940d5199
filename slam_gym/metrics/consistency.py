"""Consistency of the filter: normalised errors, compared with their χ² distribution."""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.types import Array


@compiled
def nees(error: Array, covariance: Array) -> float:
    """Normalised estimation error squared ε = eᵀ P⁻¹ e of an error e (d,) with covariance P (d, d).

    It has a χ² distribution with d degrees of freedom if the filter is consistent. Of P, only the upper triangle is
    read. A direction with variance 0 contributes nothing if its error is 0 too, as at the robot's first pose; otherwise
    ε is infinite.
    """
    d = len(error)
    factor, y = np.zeros((d, d)), np.zeros(d)  # P = L Lᵀ, y = L⁻¹ e
    total = 0.0
    for i in range(d):
        for j in range(i + 1):
            rest = covariance[j, i]
            for k in range(j):
                rest -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = rest / factor[j, j] if factor[j, j] > 0.0 else 0.0
            elif rest > 1e-15 * covariance[i, i]:
                factor[i, i] = math.sqrt(rest)
        residual = error[i]
        for k in range(i):
            residual -= factor[i, k] * y[k]
        if factor[i, i] > 0.0:
            y[i] = residual / factor[i, i]
            total += y[i] * y[i]
        elif abs(residual) > 1e-12:
            return math.inf
    return total


@compiled
def pose_nees(pose: Array, covariance: Array, true: Array) -> float:
    """NEES of a pose (3,) with covariance (3, 3) and true pose (3,); the error of the heading is wrapped."""
    error = pose - true
    error[2] = wrap_angle(error[2])
    return nees(error, covariance)


def anees(values: Array, dof: int) -> float:
    """Average NEES per degree of freedom, of values (r,) with `dof` each; NaN without values.

    It is 1 for a consistent filter, and larger for an optimistic one.
    """
    return float(np.mean(values)) / dof if len(values) else math.nan
