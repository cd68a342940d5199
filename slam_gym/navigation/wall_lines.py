"""Straight walls as a compass: what one sweep of the range finder tells of the motion since the last.

In a hall beyond whose middle no feature is in view, the heading drifts with the wheels; the walls still say where it
points. A run of echoes lies on a straight wall n·p = ρ, n = (cos α, sin α), where the inverse ranges
uᵢ = 1/rᵢ of its beams are linear in a = n/ρ,

    uᵢ = aᵀdᵢ,    dᵢ = (cos βᵢ, sin βᵢ),    var uᵢ = σ²/rᵢ⁴,

so that a is fitted recursively, a run ending with the beam that misses it. Lines of two sweeps are paired where the
wheels say that they are one. The motion (t, θ) between the sweeps is *linear* in their differences,

    α − α' = θ,    ρ − ρ' = nᵀt,

and is updated from them, starting with what the wheels report: what no wall tells, such as the way along a corridor,
remains theirs. The error of a line counts in the two motions before and after it; taking these for independent, as the
filter does, overstates what they add up to, and never understates it.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._compile import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.types import Array, Beams, Odometry

_FEWEST = 6  # echoes on a line
_GATE = 9.0  # (3 σ)² by which an echo may miss the line of those before it
_PAIRED = 9.21  # χ²₂ of .99: lines that differ by more are not one
_NEAREST = 0.3  # [m] of echoes that count
_ROUGHNESS = 0.01  # [m] σ of a wall about its line, across it …
_BENT, _SHIFTED = 0.0015**2, 0.01**2  # [rad²], [m²] of any line: a recess that beams graze bends it
_GRAZING = 1e-3  # … and at most by 1 / √ of this more along a beam


class WallCompass:
    """Corrects the wheels' report by the straight walls in view of one sweep after the other.

    `sigma` [m] is that of the range finder.
    """

    def __init__(self, sigma: float) -> None:
        self._variance = sigma * sigma
        self._last = _lines(np.empty(0), np.empty(0), 0.0, 1.0)

    def corrected(self, odometry: Odometry, beams: Beams) -> Odometry:
        """The motion since the last sweep, by the wheels' `odometry` and by the walls in view of both sweeps."""
        lines = _lines(beams.bearings, beams.ranges, beams.max_range, self._variance)
        motion, covariance = odometry.motion.copy(), odometry.covariance.copy()
        _correct(motion, covariance, self._last, lines)
        self._last = lines
        return Odometry(motion, covariance)


@compiled
def _lines(bearings: Array, ranges: Array, max_range: float, variance: float) -> Array:
    """(l, 5) α [rad], ρ [m] and their covariance αα, αρ, ρρ of the walls in R that runs of beams end on."""
    out, count, b = np.empty((len(bearings), 5)), 0, 0
    while b + _FEWEST <= len(bearings):
        a, C, end = _run(bearings, ranges, max_range, variance, b)
        if end - b >= _FEWEST:
            square = a[0] * a[0] + a[1] * a[1]
            length = math.sqrt(square)
            out[count, 0], out[count, 1] = math.atan2(a[1], a[0]), 1.0 / length
            turn_x, turn_y = -a[1] / square, a[0] / square
            away_x, away_y = -a[0] / (square * length), -a[1] / (square * length)
            out[count, 2] = turn_x * (C[0] * turn_x + C[1] * turn_y) + turn_y * (C[1] * turn_x + C[2] * turn_y)
            out[count, 3] = turn_x * (C[0] * away_x + C[1] * away_y) + turn_y * (C[1] * away_x + C[2] * away_y)
            out[count, 4] = away_x * (C[0] * away_x + C[1] * away_y) + away_y * (C[1] * away_x + C[2] * away_y)
            out[count, 2] += _BENT
            out[count, 4] += _SHIFTED
            count, b = count + 1, end
        else:
            b += 1
    return out[:count].copy()


@compiled
def _run(
    bearings: Array, ranges: Array, max_range: float, variance: float, first: int
) -> tuple[tuple[float, float], tuple[float, float, float], int]:
    """The line a through the longest run of echoes from beam `first` on, its covariance xx, xy, yy, and the run's end.

    Recursive least squares over the inverse ranges; what the line may miss the next echo by allows for its own error.
    """
    mxx = mxy = myy = hx = hy = ax = ay = xx = xy = yy = 0.0
    b = first
    while b < len(bearings):
        r = ranges[b]
        if not _NEAREST < r < max_range:
            break
        x, y, u = math.cos(bearings[b]), math.sin(bearings[b]), 1.0 / r
        known = b - first >= 2
        straight_on = (ax * x + ay * y) ** 2 / (ax * ax + ay * ay) if known else 1.0  # cos² from beam to normal
        weight = r**4 / (variance + _ROUGHNESS**2 / max(straight_on, _GRAZING))
        if known:
            missed = u - ax * x - ay * y
            if missed * missed > _GATE * (1.0 / weight + x * (xx * x + xy * y) + y * (xy * x + yy * y)):
                break
        mxx, mxy, myy = mxx + weight * x * x, mxy + weight * x * y, myy + weight * y * y
        hx, hy = hx + weight * x * u, hy + weight * y * u
        b += 1
        if b - first >= 2:
            determinant = mxx * myy - mxy * mxy
            xx, xy, yy = myy / determinant, -mxy / determinant, mxx / determinant
            ax, ay = xx * hx + xy * hy, xy * hx + yy * hy
    return (ax, ay), (xx, xy, yy), b


@compiled
def _correct(motion: Array, P: Array, before: Array, after: Array) -> None:
    """Update the motion (3,) and its covariance (3, 3) with the lines (k, 5) and (l, 5) that are one."""
    used = np.zeros(len(before), np.bool_)
    for j in range(len(after)):
        best, row = _PAIRED, -1
        for i in range(len(before)):
            if not used[i]:
                distance = _compare(motion, P, before[i], after[j])[0]
                if distance < best:
                    best, row = distance, i
        if row >= 0:
            used[row] = True
            _update(motion, P, before[row], after[j])


@compiled
def _compare(
    motion: Array, P: Array, before: Array, after: Array
) -> tuple[float, tuple[float, float], tuple[float, float, float]]:
    """D² of two lines being one, their innovation (α, ρ), and its covariance αα, αρ, ρρ."""
    c, s = math.cos(before[0]), math.sin(before[0])
    turn = wrap_angle(before[0] - after[0] - motion[2])
    away = before[1] - after[1] - c * motion[0] - s * motion[1]
    tt = P[2, 2] + before[2] + after[2]
    ta = c * P[0, 2] + s * P[1, 2] + before[3] + after[3]
    aa = c * (c * P[0, 0] + s * P[0, 1]) + s * (c * P[0, 1] + s * P[1, 1]) + before[4] + after[4]
    determinant = tt * aa - ta * ta
    distance = (aa * turn * turn - 2.0 * ta * turn * away + tt * away * away) / determinant
    return distance, (turn, away), (tt, ta, aa)


@compiled
def _update(motion: Array, P: Array, before: Array, after: Array) -> None:
    """One update of the motion from a pair of lines: K = P Hᵀ S⁻¹, P ← P − K S Kᵀ."""
    _, (turn, away), (tt, ta, aa) = _compare(motion, P, before, after)
    c, s, determinant = math.cos(before[0]), math.sin(before[0]), tt * aa - ta * ta
    PH, K = np.empty((3, 2)), np.empty((3, 2))
    for i in range(3):
        PH[i, 0], PH[i, 1] = P[i, 2], c * P[i, 0] + s * P[i, 1]
        K[i, 0] = (aa * PH[i, 0] - ta * PH[i, 1]) / determinant
        K[i, 1] = (tt * PH[i, 1] - ta * PH[i, 0]) / determinant
    for i in range(3):
        motion[i] += K[i, 0] * turn + K[i, 1] * away
        for j in range(3):
            P[i, j] -= K[i, 0] * PH[j, 0] + K[i, 1] * PH[j, 1]
    for i in range(3):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
