"""Straight walls as a compass: what two sweeps of the range finder tell of the motion between them.

In a hall where no feature is in sight the heading drifts with the wheels; the walls still say where the robot points.
A run of echoes lies on a straight wall n·p = ρ, n = (cos α, sin α), where the inverse ranges of its beams are linear in
a = n/ρ,

    uᵢ = 1/rᵢ = aᵀdᵢ,    dᵢ = (cos βᵢ, sin βᵢ),    var uᵢ = var rᵢ / rᵢ⁴,

so that a is fitted recursively, and the beam that misses it ends the run. Lines of two sweeps are one where the wheels
say that they may be. The motion (t, θ) between the sweeps is *linear* in how they differ,

    α − α' = θ,    ρ − ρ' = nᵀt,

and is updated by that, starting with what the wheels report: what no wall tells, such as the way along a corridor,
remains theirs. The error of a line counts in the motions before and after it, with opposite signs; a filter that takes
these for independent overstates what they add up to. A wall that is bent all along is taken for a polygon.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.types import Array, Beams, Odometry

_FEWEST = 6  # echoes on a line
_GATE = 9.0  # (3 σ)² by which an echo may miss the line of those before it
_PAIRED = 9.21  # χ²₂ of 0.99: lines that differ by more are not one
_NEAREST = 0.3  # [m] of echoes that count
_ROUGH = 0.01**2  # [m²] of a wall about its line, across it …
_GRAZING = 1e-3  # … and along a beam at most by 1/√ of this more
_BENT, _SHIFTED = 0.0015**2, 0.01**2  # [rad²], [m²] of any line: a recess that many beams graze bends it


class WallCompass:
    """Corrects what the wheels report by the straight walls in view, sweep after sweep.

    `sigma` [m] is that of the range finder.
    """

    def __init__(self, sigma: float) -> None:
        self._variance = sigma * sigma
        self._last = np.empty((0, 5))  # lines of the last sweep

    def corrected(self, odometry: Odometry, beams: Beams) -> Odometry:
        """The motion since the last sweep, which the wheels report as `odometry`, and from which `beams` were taken."""
        motion, covariance = odometry.motion.copy(), odometry.covariance.copy()
        swept = beams.bearings, beams.ranges, beams.max_range
        self._last = _correct(motion, covariance, self._last, swept, self._variance)
        return Odometry(motion, covariance)


class _Run(NamedTuple):
    """Echoes on one line: a, its covariance, and the beam after the last of them."""

    ax: float  # [1/m]
    ay: float
    xx: float  # [1/m²]
    xy: float
    yy: float
    end: int


class _Difference(NamedTuple):
    """Of two lines that may be one, beyond what the motion explains, with its covariance and D²."""

    turn: float  # [rad]
    away: float  # [m]
    tt: float
    ta: float
    aa: float
    distance: float


@compiled
def _lines(bearings: Array, ranges: Array, max_range: float, variance: float) -> Array:
    """(l, 5) α [rad], ρ [m] and their covariance αα, αρ, ρρ: the walls in R that runs of echoes lie on."""
    out, count, b = np.empty((len(bearings), 5)), 0, 0
    while b + _FEWEST <= len(bearings):
        run = _run(bearings, ranges, max_range, variance, b)
        if run.end - b < _FEWEST:
            b += 1
            continue
        square = run.ax * run.ax + run.ay * run.ay
        root = math.sqrt(square)
        tx, ty, dx, dy = -run.ay / square, run.ax / square, -run.ax / (square * root), -run.ay / (square * root)
        out[count, 0], out[count, 1] = math.atan2(run.ay, run.ax), 1.0 / root
        out[count, 2] = tx * tx * run.xx + 2.0 * tx * ty * run.xy + ty * ty * run.yy + _BENT
        out[count, 3] = tx * dx * run.xx + (tx * dy + ty * dx) * run.xy + ty * dy * run.yy
        out[count, 4] = dx * dx * run.xx + 2.0 * dx * dy * run.xy + dy * dy * run.yy + _SHIFTED
        count, b = count + 1, run.end
    return out[:count].copy()


@compiled
def _run(bearings: Array, ranges: Array, max_range: float, variance: float, first: int) -> _Run:
    """The run of echoes from beam `first` on, by recursive least squares.

    What the line may miss the next echo by allows for its own error.
    """
    mxx = mxy = myy = hx = hy = ax = ay = xx = xy = yy = 0.0
    b = first
    while b < len(bearings):
        r = ranges[b]
        if not _NEAREST < r < max_range:
            break
        x, y, u, known = math.cos(bearings[b]), math.sin(bearings[b]), 1.0 / r, b - first >= 2
        facing = (ax * x + ay * y) ** 2 / (ax * ax + ay * ay) if known else 1.0  # cos² from the beam to the normal
        weight = r**4 / (variance + _ROUGH / max(facing, _GRAZING))
        if known:
            missed = u - ax * x - ay * y
            if missed * missed > _GATE * (1.0 / weight + x * x * xx + 2.0 * x * y * xy + y * y * yy):
                break
        mxx, mxy, myy = mxx + weight * x * x, mxy + weight * x * y, myy + weight * y * y
        hx, hy = hx + weight * x * u, hy + weight * y * u
        b += 1
        if b - first >= 2:
            determinant = mxx * myy - mxy * mxy
            xx, xy, yy = myy / determinant, -mxy / determinant, mxx / determinant
            ax, ay = xx * hx + xy * hy, xy * hx + yy * hy
    return _Run(ax, ay, xx, xy, yy, b)


@compiled
def _correct(motion: Array, P: Array, before: Array, beams: tuple[Array, Array, float], variance: float) -> Array:
    """The lines (l, 5) of a sweep; updates the motion (3,) and its covariance (3, 3) with those that are one of the
    lines `before` (k, 5)."""
    (bearings, ranges, max_range), used = beams, np.zeros(len(before), np.bool_)
    after = _lines(bearings, ranges, max_range, variance)
    for j in range(len(after)):
        least, row = _PAIRED, -1
        for i in range(len(before)):
            distance = math.inf if used[i] else _difference(motion, P, before[i], after[j]).distance
            if distance < least:
                least, row = distance, i
        if row >= 0:
            used[row] = True
            _update(motion, P, before[row], after[j])
    return after


@compiled
def _difference(motion: Array, P: Array, before: Array, after: Array) -> _Difference:
    """S = H P Hᵀ + C + C', with a row (0, 0, 1) of H for the turn and (n, 0) for the distance."""
    c, s = math.cos(before[0]), math.sin(before[0])
    turn = wrap_angle(before[0] - after[0] - motion[2])
    away = before[1] - after[1] - c * motion[0] - s * motion[1]
    tt = P[2, 2] + before[2] + after[2]
    ta = c * P[0, 2] + s * P[1, 2] + before[3] + after[3]
    aa = c * c * P[0, 0] + 2.0 * c * s * P[0, 1] + s * s * P[1, 1] + before[4] + after[4]
    distance = (aa * turn * turn - 2.0 * ta * turn * away + tt * away * away) / (tt * aa - ta * ta)
    return _Difference(turn, away, tt, ta, aa, distance)


@compiled
def _update(motion: Array, P: Array, before: Array, after: Array) -> None:
    """K = P Hᵀ S⁻¹; the motion moves by K times the difference, and P ← P − K H P."""
    d, c, s = _difference(motion, P, before, after), math.cos(before[0]), math.sin(before[0])
    determinant, PH, K = d.tt * d.aa - d.ta * d.ta, np.empty((3, 2)), np.empty((3, 2))
    for i in range(3):
        PH[i, 0], PH[i, 1] = P[i, 2], c * P[i, 0] + s * P[i, 1]
        K[i, 0] = (d.aa * PH[i, 0] - d.ta * PH[i, 1]) / determinant
        K[i, 1] = (d.tt * PH[i, 1] - d.ta * PH[i, 0]) / determinant
    for i in range(3):
        motion[i] += K[i, 0] * d.turn + K[i, 1] * d.away
        for j in range(i + 1):
            P[i, j] -= K[i, 0] * PH[j, 0] + K[i, 1] * PH[j, 1]
            P[j, i] = P[i, j]
