"""The equations of EKF-SLAM with point features, compiled (Castellanos, Neira and Tardós 2006, chapter 9).

State x = (robot R = [x m, y m, θ rad]; features F_1 … F_n [m]), all in B; d = 3 + 2n, feature j starts at 3 + 2j.
**Only the upper triangle of P is stored**: P is symmetric by construction, and the work is halved. Arrays are `padded`;
entries beyond d and below the diagonal are meaningless.

The other properties of features are the columns of two arrays: `counted` (6, ≥ n) of integers, rows IDS to DIRECTIONS,
and `sized` (2, ≥ n), rows SIZES [m] and VARIANCES [m²], NaN where unknown. In DIRECTIONS, bit k of a feature is set
where a scan has measured it while the robot, as estimated then, was in the k-th of `SECTORS` sectors around it, counted
anticlockwise from the x axis of B. Joining maps turns them, to whole sectors; other corrections of the map do not.

The robot's rotation is C and its position t; J = [0 −1; 1 0], so that JΔ = (−Δ_y, Δ_x)ᵀ.

Here the robot moves, and features are added and removed. The update by measurements is in `update.py`.
"""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.mapping.linear_algebra import is_covariance
from slam_gym.types import LARGEST, UNKNOWN_KIND, UNPAIRED, Array, IntArray, ScanArrays

# id, number of steps that saw it, the first and the last, class, directions from which it was seen
IDS, SEEN, FIRST_SEEN, LAST_SEEN, KINDS, DIRECTIONS = range(6)
SIZES, VARIANCES = range(2)
SECTORS = 60  # of 6° each, around a feature

MapArrays = tuple[Array, Array, IntArray, Array]
"""x, P, `counted` and `sized` of a map."""


@compiled
def turned(c: float, s: float, xx: float, xy: float, yy: float) -> tuple[float, float, float]:
    """C Σ Cᵀ for the symmetric Σ = [xx xy; xy yy] and the rotation with cosine c and sine s: entries xx, xy, yy."""
    across = c * s * (xx - yy) + (c * c - s * s) * xy
    return c * c * xx - 2.0 * c * s * xy + s * s * yy, across, s * s * xx + 2.0 * c * s * xy + c * c * yy


@compiled
def predict(x: Array, P: Array, d: int, motion: Array, Q: Array) -> None:
    """x_R ← x_R ⊕ u, P_RR ← F P_RR Fᵀ + G Q Gᵀ, P_RF ← F P_RF.

    F = [I JΔ; 0 1] with Δ the robot's displacement in B; G = diag(C, 1). u (3,) [m, m, rad], Q (3, 3) its covariance.
    Raises ValueError, with nothing changed, where u is not finite or above `LARGEST`, or Q is no covariance.
    """
    is_possible = is_covariance(Q)
    for i in range(3):
        is_possible &= abs(motion[i]) <= LARGEST and Q[i, i] <= LARGEST * LARGEST
    if not is_possible:
        raise ValueError("odometry: not finite, above 1e9 m, or its covariance is not positive semi-definite")
    c, s = math.cos(x[2]), math.sin(x[2])
    x_new, y_new = x[0] + c * motion[0] - s * motion[1], x[1] + s * motion[0] + c * motion[1]
    dx, dy = x_new - x[0], y_new - x[1]
    x[0], x[1], x[2] = x_new, y_new, wrap_angle(x[2] + motion[2])
    xt, yt, tt = P[0, 2], P[1, 2], P[2, 2]
    qxx, qxy, qyy = turned(c, s, Q[0, 0], Q[0, 1], Q[1, 1])
    P[0, 0] += dy * (dy * tt - 2.0 * xt) + qxx
    P[0, 1] += dx * xt - dy * yt - dx * dy * tt + qxy
    P[1, 1] += dx * (dx * tt + 2.0 * yt) + qyy
    P[0, 2] += -dy * tt + c * Q[0, 2] - s * Q[1, 2]
    P[1, 2] += dx * tt + s * Q[0, 2] + c * Q[1, 2]
    P[2, 2] += Q[2, 2]
    rows_x, rows_y, rows_t = P[0, 3:d], P[1, 3:d], P[2, 3:d]
    for j in range(len(rows_t)):
        rows_x[j] -= dy * rows_t[j]
        rows_y[j] += dx * rows_t[j]


def symmetric(P: Array, d: int) -> Array:
    """A copy of P[:d, :d] with both triangles filled in."""
    upper = np.triu(P[:d, :d])
    return upper + np.triu(upper, 1).T


@compiled
def relative_covariance(P: Array, i: int, j: int) -> tuple[float, float, float]:
    """[m²] xx, xy and yy of P_ii + P_jj − P_ij − P_ji, the covariance of F_i − F_j."""
    p, q = 3 + 2 * i, 3 + 2 * j
    low, high = min(p, q), max(p, q)
    if low == high:
        return 0.0, 0.0, 0.0
    xx = P[p, p] + P[q, q] - 2.0 * P[low, high]
    yy = P[p + 1, p + 1] + P[q + 1, q + 1] - 2.0 * P[low + 1, high + 1]
    return xx, P[p, p + 1] + P[q, q + 1] - P[low, high + 1] - P[low + 1, high], yy


@compiled
def distances_between(x: Array, P: Array, first: IntArray, second: IntArray, gate: float) -> Array:
    """(a, b) D²_ij = (F_i − F_j)ᵀ (P_ii + P_jj − P_ij − P_ji)⁻¹ (F_i − F_j), inf where it is not less than the gate.

    As P_ii + P_jj − P_ij − P_ji ≤ 2 (P_ii + P_jj), most pairs are rejected before P_ij is read.
    """
    out = np.full((len(first), len(second)), np.inf)
    for a in range(len(first)):
        p = 3 + 2 * first[a]
        for b in range(len(second)):
            q = 3 + 2 * second[b]
            u, v = x[p] - x[q], x[p + 1] - x[q + 1]
            widest = 2.0 * (P[p, p] + P[p + 1, p + 1] + P[q, q] + P[q + 1, q + 1])
            if u * u + v * v >= gate * widest:
                continue
            xx, xy, yy = relative_covariance(P, first[a], second[b])
            determinant = xx * yy - xy * xy
            if determinant > 0.0:
                distance = (yy * u * u - 2.0 * xy * u * v + xx * v * v) / determinant
                out[a, b] = distance if distance < gate else np.inf
    return out


@compiled
def add(arrays: MapArrays, n: int, step: int, next_id: int, scan: ScanArrays, i: int) -> None:
    """Append feature n, x_F = x_R ⊕ z with z measurement i, its covariance by linearisation.

    P_F· = [I JΔ] P_R·, P_FF = [I JΔ] P_RR [I JΔ]ᵀ + C R Cᵀ, with Δ = x_F − t. Raises ValueError for an invalid z.
    """
    (x, P, counted, sized), (points, covariances, sizes, variances, kinds) = arrays, scan
    d, point, R = 3 + 2 * n, points[i], covariances[i]
    check_measurement(points, covariances, i)
    c, s = math.cos(x[2]), math.sin(x[2])
    x[d], x[d + 1] = x[0] + c * point[0] - s * point[1], x[1] + s * point[0] + c * point[1]
    dx, dy = x[d] - x[0], x[d + 1] - x[1]
    for j in range(d):
        xj, yj, tj = P[min(0, j), max(0, j)], P[min(1, j), max(1, j)], P[min(2, j), max(2, j)]
        P[j, d], P[j, d + 1] = xj - dy * tj, yj + dx * tj
    rxx, rxy, ryy = turned(c, s, R[0, 0], R[0, 1], R[1, 1])
    P[d, d], P[d, d + 1] = P[0, d] - dy * P[2, d] + rxx, P[0, d + 1] - dy * P[2, d + 1] + rxy
    P[d + 1, d + 1] = P[1, d + 1] + dx * P[2, d + 1] + ryy
    counted[IDS, n], counted[SEEN, n], counted[KINDS, n] = next_id, 1, kinds[i]
    counted[FIRST_SEEN, n] = counted[LAST_SEEN, n] = step
    counted[DIRECTIONS, n] = 1 << sector_of(x, n)
    known = math.isfinite(sizes[i]) and 0.0 < variances[i] < math.inf
    sized[SIZES, n], sized[VARIANCES, n] = sizes[i] if known else math.nan, variances[i] if known else math.nan


@compiled
def sector_of(x: Array, feature: int) -> int:
    """The sector of a feature in which the robot is."""
    f = 3 + 2 * feature
    turns = math.atan2(x[1] - x[f + 1], x[0] - x[f]) / (2.0 * math.pi)
    return int((turns - math.floor(turns)) * SECTORS) % SECTORS


@compiled
def check_measurement(points: Array, covariances: Array, i: int) -> None:
    """Raise ValueError unless measurement i is finite, with a valid covariance."""
    is_near = abs(points[i, 0]) <= LARGEST and abs(points[i, 1]) <= LARGEST
    if not (is_near and is_covariance(covariances[i])):
        raise ValueError(f"scan: measurement {i} is not finite, or its covariance is invalid")


@compiled
def keep(arrays: MapArrays, kept: IntArray) -> None:
    """Marginalise, in place, all features out of the map except `kept` (n',), which ascend."""
    x, P, counted, sized = arrays
    first = 0  # everything before the first gap stays where it is
    while first < len(kept) and kept[first] == first:
        first += 1
    old = np.arange(3 + 2 * len(kept))
    for j in range(first, len(kept)):
        old[3 + 2 * j], old[4 + 2 * j] = 3 + 2 * kept[j], 4 + 2 * kept[j]
        for row in range(len(counted)):
            counted[row, j] = counted[row, kept[j]]
        for row in range(len(sized)):
            sized[row, j] = sized[row, kept[j]]
    for i in range(len(old)):
        x[i] = x[old[i]]
        for j in range(max(i, 3 + 2 * first), len(old)):
            P[i, j] = P[old[i], old[j]]


@compiled
def record(arrays: MapArrays, step: int, scan: ScanArrays, features: IntArray) -> None:
    """Count this step once for each of `features` (m,), and learn their sizes, kinds and directions from the scan.

    A scalar Kalman filter updates a size: the first measured size replaces an unknown one (NaN), and a measured size
    that is NaN, or whose variance is not positive and finite, is ignored. The kind is the last that was reported.
    """
    (x, _, counted, sized), (_, _, measured_sizes, measured_variances, measured_kinds) = arrays, scan
    seen, last_seen, kinds, directions = counted[SEEN], counted[LAST_SEEN], counted[KINDS], counted[DIRECTIONS]
    sizes, variances = sized[SIZES], sized[VARIANCES]
    for i in range(len(features)):
        f = features[i]
        if f == UNPAIRED:
            continue
        if last_seen[f] != step:
            seen[f] += 1
            last_seen[f] = step
        directions[f] |= 1 << sector_of(x, f)
        if measured_kinds[i] != UNKNOWN_KIND:
            kinds[f] = measured_kinds[i]
        z, r = measured_sizes[i], measured_variances[i]
        if not (math.isfinite(z) and 0.0 < r < math.inf):
            continue
        if math.isfinite(sizes[f]):
            gain = variances[f] / (variances[f] + r)
            sizes[f] += gain * (z - sizes[f])
            variances[f] *= 1.0 - gain
        else:
            sizes[f], variances[f] = z, r
