"""The measurements that the map predicts: features in reach, their positions in R, and the covariances. Compiled.

State x and P (upper triangle) are those of `ekf`; h_j(x) = Cᵀ(F_j − t) and H_j = Cᵀ[−I  −JΔ  0 … I … 0] are its
measurement function and Jacobian.

**To second order** an uncertain heading shifts and widens the prediction. With ν = H_j δ the linear error of the
prediction and δθ the error of the heading, Gaussian with covariances from P, in the coordinates of the group (see
`update`),

    h_j(x ⊞ δ) = h_j(x) + ν − ½ δθ J ν + …,

whose mean is h_j − ½ J c_j with c_j = H_j P e_θ, and whose covariance, for two features, is

    H_i P H_jᵀ + ¼ J (σ_θ² H_i P H_jᵀ + c_i c_jᵀ) Jᵀ.

If only the heading is uncertain, ν = −δθ J h: the mean is h shortened by ½ σ_θ², and ½ σ_θ⁴ h hᵀ is added to the
covariance, the first terms of the moments of a point rotated by a Gaussian angle. A heading error that all features
share has no such effect.

**A feature faces the robot** if it is visible from the robot's direction. The walls that form a corner hide it from a
quarter of all directions, or from three quarters if it points inwards; what stands near it hides it from more. Of
features mapped long ago and not hidden by known walls, scans from up to 10° beside a direction from which they were
seen show about half, from 40° a sixth, and from more than 60° one in twenty (`loop`, `drift-2` and a floor of 200 m,
train worlds). `facing` lies somewhat above these fractions. ORB-SLAM searches map points only within 60° of their mean
viewing direction for the same reason (Mur-Artal et al. 2015).
"""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.mapping import ekf
from slam_gym.mapping.covisibility import Counts, mark_local
from slam_gym.mapping.ekf import MapArrays, turned
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray
from slam_gym.validation import check_measurements

_HIDDEN = math.radians(25.0)  # angle beside a direction from which a feature was seen at which 1/e of them are visible
_LEAST_FACING = 0.03  # of features that are not paired; of a paired one, `hypotheses.UNSEEN` is the least

RowArrays = tuple[IntArray, Array, BoolArray, Array, Array, Array]
"""Rows of (4, n): features, kinds, ages, sightings; of (3, n): sizes, variances, `facing`; near (n,), positions (n, 2),
covariances (n, 2, 2) and those with the heading (n, 2). The first k of each are filled in."""

LocalityArrays = tuple[Counts, int]
"""Counts of the covisibility graph, empty where all features are near; the step from which a scan is recent."""

Rule = tuple[float, bool, float, float]
"""Reach [m]; whether predictions are to second order; χ² gate of a pairing; number of accidental matches expected in
the gate of an old feature above which it is not offered."""


def rows_for(n: int) -> RowArrays:
    """Empty row arrays for up to n features."""
    return (
        np.empty((4, n), np.int64), np.empty((3, n)), np.empty(n, np.bool_), np.empty((n, 2)), np.empty((n, 2, 2)),
        np.empty((n, 2)),
    )  # fmt: skip


@compiled
def _relative_covariance(x: Array, P: Array, f: int) -> tuple[float, float, float]:
    """G P Gᵀ with G = C H, for the feature that starts at f: entries xx, xy, yy."""
    dx, dy = x[f] - x[0], x[f + 1] - x[1]
    # rows x, y and θ of P Gᵀ, those of the robot
    xx, xy = P[0, f] - P[0, 0] + P[0, 2] * dy, P[0, f + 1] - P[0, 1] - P[0, 2] * dx
    yy = P[1, f + 1] - P[1, 1] - P[1, 2] * dx
    tx, ty = P[2, f] - P[0, 2] + P[2, 2] * dy, P[2, f + 1] - P[1, 2] - P[2, 2] * dx
    # then the rows of the feature
    fxx, fxy = P[f, f] - P[0, f] + P[2, f] * dy, P[f, f + 1] - P[1, f] - P[2, f] * dx
    fyy = P[f + 1, f + 1] - P[1, f + 1] - P[2, f + 1] * dx
    return fxx - xx + dy * tx, fxy - xy + dy * ty, fyy - yy - dx * ty


@compiled
def foresee(
    arrays: MapArrays,
    counts: tuple[int, int],
    odometry: tuple[Array, Array],
    scan: tuple[Array, Array],
    rule: Rule,
    locality: LocalityArrays,
    pose: Array,
    out: RowArrays,
) -> int:
    """Move the robot by `ekf.predict`, and enter in `out` the features in reach that are not ambiguous.

    In reach are features with ‖h_j(x)‖ ≤ reach + 3σ, where σ² is the largest eigenvalue of H_j P H_jᵀ. To second order,
    positions and covariances are mean and covariance to second order.

    Arguments:
        arrays: arrays of the map, in which the robot is moved.
        counts: number n of its features, and number of steps that have ended in it.
        odometry: motion (3,), or (0,) for a robot that stands still; and its covariance (3, 3).
        scan: points (m, 2) and covariances (m, 2, 2), which are only checked.
        pose: (4,) receives the predicted pose and the variance of its heading.

    Returns the number of rows k. Raises ValueError, before the robot moves, as `check_scan` and `ekf.predict`.
    """
    (x, P, counted, sized), (n, step), (motion, Q) = arrays, counts, odometry
    (reach, second_order, gate, most), (seen_together, since), k = rule, locality, 0
    check_measurements(scan[0], scan[1])
    if len(motion) > 0:
        ekf.predict(x, P, 3 + 2 * n, motion, Q)
    pose[0], pose[1], pose[2], pose[3] = x[0], x[1], x[2], P[2, 2]
    known, sizes, near, positions, covariances, across = out
    recent = np.flatnonzero(counted[ekf.LAST_SEEN, :n] >= since)
    local, c, s = mark_local(seen_together, n, recent), math.cos(x[2]), math.sin(x[2])
    for j in range(n):
        f = 3 + 2 * j
        dx, dy = x[f] - x[0], x[f + 1] - x[1]
        beyond = math.sqrt(dx * dx + dy * dy) - reach
        xx, xy, yy = _relative_covariance(x, P, f)
        # the test compares 9σ²; the trace bounds σ², and for most features no root is needed
        if beyond > 0.0 and beyond * beyond > 9.0 * (xx + yy):
            continue
        largest = 0.5 * (xx + yy) + math.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
        if beyond > 0.0 and beyond * beyond > 9.0 * largest:
            continue
        ux, uy = c * dx + s * dy, -s * dx + c * dy
        xx, xy, yy = turned(c, -s, xx, xy, yy)
        u, v = P[2, f] - P[0, 2] + dy * P[2, 2], P[2, f + 1] - P[1, 2] - dx * P[2, 2]
        tx, ty = c * u + s * v, c * v - s * u
        if second_order:
            ux, uy = ux + 0.5 * ty, uy - 0.5 * tx
            bxx, bxy, byy = P[2, 2] * xx + tx * tx, P[2, 2] * xy + tx * ty, P[2, 2] * yy + ty * ty
            xx, xy, yy = xx + 0.25 * byy, xy - 0.25 * bxy, yy + 0.25 * bxx
        known[0, k], known[1, k] = j, counted[ekf.KINDS, j]
        known[2, k], known[3, k] = step - counted[ekf.FIRST_SEEN, j], counted[ekf.SEEN, j]
        sizes[0, k], sizes[1, k], near[k] = sized[ekf.SIZES, j], sized[ekf.VARIANCES, j], local[j]
        sizes[2, k] = facing(x, P, j, counted[ekf.DIRECTIONS, j])
        positions[k, 0], positions[k, 1], across[k, 0], across[k, 1] = ux, uy, tx, ty
        covariances[k, 0, 0], covariances[k, 0, 1] = xx, xy
        covariances[k, 1, 0], covariances[k, 1, 1] = xy, yy
        k += 1
    if most == math.inf:
        return k
    per_area = k * gate / (reach * reach) if k > 0 else 0.0
    return keep_unambiguous(out, k, P, per_area, most)


@compiled
def facing(x: Array, P: Array, feature: int, directions: int) -> float:
    """The probability that a feature which no known wall hides is visible from where the robot is.

    It is exp(−γ / 25°), at least 0.03, with γ the angle, in whole sectors, between the robot's direction and the
    nearest of `directions` from which the feature was seen, less the standard deviation of the former. It is 1 where
    none of them is known.
    """
    f, sector, sectors = 3 + 2 * feature, ekf.sector_of(x, feature), 0
    if directions == 0 or directions >> sector & 1:
        return 1.0
    for sectors in range(1, ekf.SECTORS // 2 + 1):
        if directions >> (sector + sectors) % ekf.SECTORS & 1 or directions >> (sector - sectors) % ekf.SECTORS & 1:
            break
    dx, dy = x[0] - x[f], x[1] - x[f + 1]
    xx, yy = P[0, 0] + P[f, f] - 2.0 * P[0, f], P[1, 1] + P[f + 1, f + 1] - 2.0 * P[1, f + 1]
    xy = P[0, 1] + P[f, f + 1] - P[0, f + 1] - P[1, f]
    across = math.sqrt(max(dy * dy * xx - 2.0 * dx * dy * xy + dx * dx * yy, 0.0))
    gamma = sectors * 2.0 * math.pi / ekf.SECTORS - across / max(dx * dx + dy * dy, 1e-9)
    return max(math.exp(-max(gamma, 0.0) / _HIDDEN), _LEAST_FACING)


@compiled
def keep_unambiguous(rows: RowArrays, k: int, P: Array, per_area: float, most: float) -> int:
    """Drop, of k rows, the old features for which more than `most` accidental matches are expected; returns how many
    rows are left, in front of the others.

    Old features are those that are not near: not local to any that was paired lately. The uncertainty of an old feature
    is measured relative to the most central near feature, because the uncertainty of the robot's pose is common to all.
    The number of other features in its gate is proportional to the gate's area, as if features were uniformly
    distributed: `per_area` is the number of features in a gate for each [m²] of √det of its covariance. Where no near
    feature is in reach, nothing is dropped.
    """
    (known, sizes, near, positions, covariances, across), x, y, near_count = rows, 0.0, 0.0, 0
    for row in range(k):
        if near[row]:
            x, y, near_count = x + positions[row, 0], y + positions[row, 1], near_count + 1
    central, least, kept = UNPAIRED, math.inf, 0
    for row in range(k):
        if near[row]:
            u, v = positions[row, 0] - x / near_count, positions[row, 1] - y / near_count
            if u * u + v * v < least:
                central, least = known[0, row], u * u + v * v
    for row in range(k):
        if not near[row] and central != UNPAIRED:
            xx, xy, yy = ekf.relative_covariance(P, central, known[0, row])
            if per_area * math.sqrt(max(xx * yy - xy * xy, 0.0)) > most:
                continue
        near[kept] = near[row]  # entry by entry: slices take two seconds to compile
        for i in range(2):
            positions[kept, i], across[kept, i] = positions[row, i], across[row, i]
            covariances[kept, i, 0], covariances[kept, i, 1] = covariances[row, i, 0], covariances[row, i, 1]
        for i in range(3):
            sizes[i, kept] = sizes[i, row]
        for i in range(4):
            known[i, kept] = known[i, row]
        kept += 1
    return kept


@compiled
def joint_covariance(x: Array, P: Array, features: IntArray, second_order: bool) -> Array:
    """H P Hᵀ (2j, 2j), the joint covariance of the predictions of `features` (j,), to second order if asked.

    The robot's terms are those of `_relative_covariance`, computed once per feature instead of once per pair.
    """
    m = len(features)
    out, offset, robot = np.empty((2 * m, 2 * m)), np.empty((m, 2)), np.empty((m, 6))
    c, s = math.cos(x[2]), math.sin(x[2])
    pxx, pxy, pyy, pxt, pyt, ptt = P[0, 0], P[0, 1], P[1, 1], P[0, 2], P[1, 2], P[2, 2]
    for i in range(m):
        f = 3 + 2 * features[i]
        dx, dy = x[f] - x[0], x[f + 1] - x[1]
        offset[i, 0], offset[i, 1] = dx, dy
        # rows x, y and θ of P G_iᵀ for the robot
        robot[i, 0], robot[i, 1] = P[0, f] - pxx + pxt * dy, P[0, f + 1] - pxy - pxt * dx
        robot[i, 2], robot[i, 3] = P[1, f] - pxy + pyt * dy, P[1, f + 1] - pyy - pyt * dx
        robot[i, 4], robot[i, 5] = P[2, f] - pxt + ptt * dy, P[2, f + 1] - pyt - ptt * dx
    for i in range(m):
        for j in range(i, m):
            first, second = (i, j) if features[i] <= features[j] else (j, i)
            a, b = 3 + 2 * features[first], 3 + 2 * features[second]
            ax, ay, bx, by = offset[first, 0], offset[first, 1], offset[second, 0], offset[second, 1]
            tx, ty = robot[second, 4], robot[second, 5]
            across = P[a, b + 1] if a == b else P[a + 1, b]
            xx = P[a, b] - P[0, a] + P[2, a] * by - robot[second, 0] + ay * tx
            xy = P[a, b + 1] - P[1, a] - P[2, a] * bx - robot[second, 1] + ay * ty
            yx = across - P[0, a + 1] + P[2, a + 1] * by - robot[second, 2] - ax * tx
            yy = P[a + 1, b + 1] - P[1, a + 1] - P[2, a + 1] * bx - robot[second, 3] - ax * ty
            if second_order:
                px, py = robot[first, 4], robot[first, 5]
                bxx, bxy, byx, byy = ptt * xx + px * tx, ptt * xy + px * ty, ptt * yx + py * tx, ptt * yy + py * ty
                xx, xy, yx, yy = xx + 0.25 * byy, xy - 0.25 * byx, yx - 0.25 * bxy, yy + 0.25 * bxx
            # Cᵀ · C, columns first
            top_x, top_y = c * xx + s * xy, -s * xx + c * xy
            low_x, low_y = c * yx + s * yy, -s * yx + c * yy
            a, b = 2 * first, 2 * second
            out[a, b], out[a, b + 1] = c * top_x + s * low_x, c * top_y + s * low_y
            out[a + 1, b], out[a + 1, b + 1] = -s * top_x + c * low_x, -s * top_y + c * low_y
            out[b, a], out[b + 1, a + 1], out[b + 1, a] = out[a, b], out[a + 1, b + 1], out[a, b + 1]
            out[b, a + 1] = out[a + 1, b]
    return out
