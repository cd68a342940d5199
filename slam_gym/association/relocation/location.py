"""The pose of the robot under a hypothesis, without a prior: its estimate, covariance, and fit to the pairings.

For pairings of measurements z_a (noise R_a, in R) with features F_a (joint covariance P, in B) and a pose (t, θ), the
errors e_a = F_a − t − C(θ) z_a have the joint covariance S = P + diag(C R_a Cᵀ). With A = ∂(t + C z)/∂(t, θ) stacked,
the pose that minimises D² = eᵀS⁻¹e is found by Gauss–Newton steps δ = (AᵀS⁻¹A)⁻¹AᵀS⁻¹e. Its covariance is (AᵀS⁻¹A)⁻¹,
that of a joint EKF update of an uninformative prior, iterated to convergence. Since three numbers are fitted to 2k, D²
follows χ² with 2k − 3 degrees of freedom. The initial guess is the closed form of Umeyama (IEEE TPAMI 13(4), 1991)
without scale, where each pairing is weighted by the inverse of its variances' sum.
"""

import math
from dataclasses import dataclass

import numpy as np

from slam_gym._jit import compiled, inlined
from slam_gym.association.relocation.constraints import Mapped, Path, cross_covariance, scan_arrays, unchecked_map
from slam_gym.geometry import wrap_angle
from slam_gym.mapping.linear_algebra import cholesky, whiten
from slam_gym.types import UNPAIRED, Array, IntArray, Landmarks, Scan

_ITERATIONS = 50
_STEP = 1e-9  # [m, rad] converged when no component of a step is larger
VARIANCE_FLOOR = 1e-12  # [m²] added to variances, so that points without error can be located too


@dataclass(frozen=True, slots=True)
class Located:
    """The pose that fits a hypothesis best."""

    pose: Array  # (3,) [m, m, rad] of the robot in B; NaN where the pairings do not determine it
    covariance: Array  # (3, 3) [m², m·rad, rad²]; NaN in the same cases
    joint_distance: float  # D²_H at that pose; 0 with fewer than two pairings; inf where the pose is not determined
    dof: int  # 2k − 3 for k pairings; 0 with fewer than two


def locate(scan: Scan, landmarks: Landmarks, features: IntArray) -> Located:
    """The pose of the robot in B under the hypothesis that pairs measurement i with features[i], (m,) or UNPAIRED.

    At least two pairings are needed, of measurements at different points. Raises ValueError for a bad scan (as
    `scan_arrays`), for unknown features, and where the joint covariance of the pairings is not positive definite.
    """
    points, noise, *_ = scan_arrays(scan)
    if len(features) != len(scan):
        raise ValueError(f"features: {len(features)} decisions for {len(scan)} measurements")
    paired = np.flatnonzero(features != UNPAIRED)
    path, k = Path(paired, features[paired].astype(np.int64)), len(paired)
    if k and not (path.features.min() >= 0 and path.features.max() < len(landmarks)):
        raise ValueError(f"features: {features.tolist()} for a map of {len(landmarks)} features")
    pose, covariance, distance = np.full(3, math.nan), np.full((3, 3), math.nan), 0.0
    if k >= 2:
        distance = locate_pairings(points, noise, unchecked_map(landmarks), path, k, pose, covariance)
    if math.isnan(distance):
        raise ValueError(
            f"landmarks: the joint covariance of features {features.tolist()} is not positive definite, or not finite"
        )
    return Located(pose, covariance, distance, max(2 * k - 3, 0))


@compiled
def locate_pairings(
    points: Array, noise: Array, mapped: Mapped, path: Path, k: int, pose: Array, pose_covariance: Array
) -> float:
    """D² of the first k ≥ 2 pairings of a path; `pose` (3,) and `pose_covariance` (3, 3) are written.

    D² is NaN where S is not positive definite, and inf where the pose is not determined. The pose is NaN in both cases.
    """
    measurements, features = path.measurements[:k], path.features[:k]
    z, R, F, P = points[measurements], noise[measurements], mapped.positions[features], np.empty((2 * k, 2 * k))
    for a in range(k):
        for b in range(a + 1):
            xx, xy, yx, yy = cross_covariance(mapped, features[a], features[b])
            P[2 * a, 2 * b], P[2 * a, 2 * b + 1], P[2 * a + 1, 2 * b], P[2 * a + 1, 2 * b + 1] = xx, xy, yx, yy
    _closed_form(z, R, F, P, pose)
    S, A, e = np.empty((2 * k, 2 * k)), np.empty((2 * k, 3)), np.empty(2 * k)
    distance, normal, step = math.nan, np.empty((3, 3)), np.empty(3)
    for iteration in range(_ITERATIONS):
        _linearise(z, R, F, P, pose, (S, A, e))
        distance = math.nan
        if not cholesky(S):
            break
        whiten(S, A, e)
        distance = _solve(A, e, normal, pose_covariance, step)
        if distance == math.inf:
            break
        if max(abs(step[0]), abs(step[1]), abs(step[2])) < _STEP or iteration == _ITERATIONS - 1:
            break  # D² is that of this pose, also where the iterations run out
        pose += step
    if not distance < math.inf:
        pose[:], pose_covariance[:] = math.nan, math.nan
        return distance
    pose[2] = wrap_angle(pose[2])
    return distance


@inlined
def place_of(points: Array, noise: Array, i: int, pose: Array, P: Array) -> tuple[float, float, float, float, float]:
    """Position and covariance of a measurement in B, from a pose with covariance P: x, y, xx, xy, yy.

    t + C z with covariance J P Jᵀ + C R Cᵀ, where J = ∂(t + C z)/∂(t, θ).
    """
    c, s, R = math.cos(pose[2]), math.sin(pose[2]), noise[i]
    u, v = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
    xx = P[0, 0] - 2.0 * v * P[0, 2] + v * v * P[2, 2] + c * c * R[0, 0] - 2.0 * c * s * R[0, 1] + s * s * R[1, 1]
    yy = P[1, 1] + 2.0 * u * P[1, 2] + u * u * P[2, 2] + s * s * R[0, 0] + 2.0 * c * s * R[0, 1] + c * c * R[1, 1]
    xy = P[0, 1] + u * P[0, 2] - v * P[1, 2] - u * v * P[2, 2]
    xy += c * s * (R[0, 0] - R[1, 1]) + (c * c - s * s) * R[0, 1]
    return pose[0] + u, pose[1] + v, xx, xy, yy


@compiled
def _closed_form(points: Array, noise: Array, positions: Array, P: Array, pose: Array) -> None:
    """Weighted Umeyama without scale: θ from the weighted sums of products about the centroids, then t."""
    total, zx, zy, fx, fy, weights = 0.0, 0.0, 0.0, 0.0, 0.0, np.empty(len(points))
    for a in range(len(points)):
        R, z, F = noise[a], points[a], positions[a]
        weight = weights[a] = 1.0 / (R[0, 0] + R[1, 1] + P[2 * a, 2 * a] + P[2 * a + 1, 2 * a + 1] + VARIANCE_FLOOR)
        total += weight
        zx, zy, fx, fy = zx + weight * z[0], zy + weight * z[1], fx + weight * F[0], fy + weight * F[1]
    zx, zy, fx, fy = zx / total, zy / total, fx / total, fy / total
    along, across = 0.0, 0.0
    for a in range(len(points)):
        x, y, u, v = points[a, 0] - zx, points[a, 1] - zy, positions[a, 0] - fx, positions[a, 1] - fy
        along += weights[a] * (x * u + y * v)
        across += weights[a] * (x * v - y * u)
    pose[2] = math.atan2(across, along)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    pose[0], pose[1] = fx - c * zx + s * zy, fy - s * zx - c * zy


@compiled
def _linearise(
    points: Array, noise: Array, positions: Array, P: Array, pose: Array, out: tuple[Array, Array, Array]
) -> None:
    """Write the lower triangle of S, A (2k, 3) and e (2k,), all at `pose`."""
    (S, A, e), c, s = out, math.cos(pose[2]), math.sin(pose[2])
    for a in range(len(points)):
        u, v = c * points[a, 0] - s * points[a, 1], s * points[a, 0] + c * points[a, 1]
        p, q = 2 * a, 2 * a + 1
        A[p, 0], A[p, 1], A[p, 2], e[p] = 1.0, 0.0, -v, positions[a, 0] - pose[0] - u
        A[q, 0], A[q, 1], A[q, 2], e[q] = 0.0, 1.0, u, positions[a, 1] - pose[1] - v
        for b in range(p):
            S[p, b], S[q, b] = P[p, b], P[q, b]
        xx, xy, yy = noise[a, 0, 0], noise[a, 0, 1], noise[a, 1, 1]
        S[p, p] = P[p, p] + VARIANCE_FLOOR + c * c * xx - 2.0 * c * s * xy + s * s * yy
        S[q, p] = P[q, p] + c * s * (xx - yy) + (c * c - s * s) * xy
        S[q, q] = P[q, q] + VARIANCE_FLOOR + s * s * xx + 2.0 * c * s * xy + c * c * yy


@compiled
def _solve(A: Array, errors: Array, normal: Array, inverse: Array, step: Array) -> float:
    """From whitened A and e: (AᵀS⁻¹A)⁻¹ into `inverse`, δ into `step`. Returns D² before the step; inf if singular."""
    right, distance = np.zeros(3), 0.0
    normal[:] = 0.0
    for r in range(len(errors)):
        distance += errors[r] * errors[r]
        for a in range(3):
            right[a] += A[r, a] * errors[r]
            for b in range(3):
                normal[a, b] += A[r, a] * A[r, b]
    a, b, c = normal[0, 0], normal[0, 1], normal[0, 2]
    d, e, f = normal[1, 1], normal[1, 2], normal[2, 2]
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    if not determinant > 1e-12 * a * d * f:
        return math.inf
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = d * f - e * e, a * f - c * c, a * d - b * b
    inverse[0, 1] = inverse[1, 0] = c * e - b * f
    inverse[0, 2] = inverse[2, 0] = b * e - c * d
    inverse[1, 2] = inverse[2, 1] = b * c - a * e
    for r in range(3):
        step[r] = 0.0
        for q in range(3):
            inverse[r, q] /= determinant
            step[r] += inverse[r, q] * right[q]
    return distance
