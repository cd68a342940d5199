"""Straight walls as a compass: the motion between two sweeps of the range finder is corrected by the walls they share.

In a hall where no feature is in sight, the heading by odometry drifts; the walls still determine it. A run of echoes
lies on a straight wall n·p = ρ, n = (cos α, sin α), if the inverse ranges of its beams are linear in a = n/ρ,

    uᵢ = 1/rᵢ = aᵀdᵢ,    dᵢ = (cos βᵢ, sin βᵢ),    var uᵢ = var rᵢ / rᵢ⁴,

so a is fitted recursively, and a beam that misses the line ends the run. Lines of two sweeps are paired if odometry
allows it. Their differences are *linear* in the motion (t, θ) between the sweeps,

    α − α' = θ,    ρ − ρ' = nᵀt,

and update it, with odometry as the prior: where no wall determines the motion, such as along a corridor, odometry
remains. The error of a line enters the motions before and after its sweep, with opposite signs; a filter that assumes
them to be independent overestimates the error of their sum. A curved wall is approximated by a polygon.
"""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.types import Array, Beams, Odometry

_FEWEST = 6  # echoes on a line
_GATE = 9.0  # (3 σ)² by which an echo may miss the line of the echoes before it
_PAIRED = 9.21  # χ²₂ of 0.99: lines that differ by more are not paired
_NEAREST = 0.3  # [m] least range of an echo
_ROUGH = 0.01**2  # [m²] variance of a wall across its line …
_GRAZING = 1e-3  # … which at grazing incidence grows along the beam, at most by 1/_GRAZING
_BENT, _SHIFTED = 0.0015**2, 0.01**2  # [rad²], [m²] added to every line: a recess that many beams graze bends it


class WallCompass:
    """Corrects odometry by the straight walls in view, sweep after sweep. `sigma` [m] is that of the range finder."""

    def __init__(self, sigma: float) -> None:
        self._variance = sigma * sigma
        self._last = np.empty((0, 5))  # lines of the last sweep, see `_lines`

    def corrected(self, odometry: Odometry, beams: Beams) -> Odometry:
        """Correct `odometry`, the motion since the last sweep, by `beams`, the sweep after it."""
        motion, covariance = odometry.motion.copy(), odometry.covariance.copy()
        swept = beams.bearings, beams.ranges, beams.max_range
        self._last = _correct(motion, covariance, self._last, swept, self._variance)
        return Odometry(motion, covariance)


@compiled
def _lines(bearings: Array, ranges: Array, max_range: float, variance: float) -> Array:
    """(l, 5) walls in R that runs of echoes lie on: α [rad], ρ [m] and their covariance αα, αρ, ρρ."""
    out, count, b = np.empty((len(bearings), 5)), 0, 0
    while b + _FEWEST <= len(bearings):
        ax, ay, xx, xy, yy, end = _run(bearings, ranges, max_range, variance, b)
        if end - b < _FEWEST:
            b += 1
            continue
        square = ax * ax + ay * ay
        root = math.sqrt(square)
        tx, ty, dx, dy = -ay / square, ax / square, -ax / (square * root), -ay / (square * root)
        out[count, 0], out[count, 1] = math.atan2(ay, ax), 1.0 / root
        out[count, 2] = tx * tx * xx + 2.0 * tx * ty * xy + ty * ty * yy + _BENT
        out[count, 3] = tx * dx * xx + (tx * dy + ty * dx) * xy + ty * dy * yy
        out[count, 4] = dx * dx * xx + 2.0 * dx * dy * xy + dy * dy * yy + _SHIFTED
        count, b = count + 1, end
    return out[:count].copy()


@compiled
def _run(
    bearings: Array, ranges: Array, max_range: float, variance: float, first: int
) -> tuple[float, float, float, float, float, int]:
    """The run of echoes on one line from beam `first` on, by recursive least squares.

    The gate of the next echo includes the covariance of the line. Returns a [1/m], its covariance xx, xy, yy [1/m²],
    and the index of the beam after the last echo.
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
    return ax, ay, xx, xy, yy, b


@compiled
def _correct(motion: Array, P: Array, before: Array, beams: tuple[Array, Array, float], variance: float) -> Array:
    """Update the motion (3,) and its covariance P (3, 3) by the lines of a sweep paired with lines `before` (k, 5).

    Returns the lines (l, 5) of the sweep.
    """
    (bearings, ranges, max_range), used = beams, np.zeros(len(before), np.bool_)
    after, PH, K = _lines(bearings, ranges, max_range, variance), np.empty((3, 2)), np.empty((3, 2))
    for j in range(len(after)):
        least, row = _PAIRED, -1
        for i in range(len(before)):
            distance = math.inf if used[i] else _difference(motion, P, before[i], after[j])[-1]
            if distance < least:
                least, row = distance, i
        if row < 0:
            continue
        used[row] = True
        # K = P Hᵀ S⁻¹; the motion moves by K times the difference, and P ← P − K H P
        turn, away, tt, ta, aa, _ = _difference(motion, P, before[row], after[j])
        c, s, determinant = math.cos(before[row, 0]), math.sin(before[row, 0]), tt * aa - ta * ta
        for i in range(3):
            PH[i, 0], PH[i, 1] = P[i, 2], c * P[i, 0] + s * P[i, 1]
            K[i, 0] = (aa * PH[i, 0] - ta * PH[i, 1]) / determinant
            K[i, 1] = (tt * PH[i, 1] - ta * PH[i, 0]) / determinant
        for i in range(3):
            motion[i] += K[i, 0] * turn + K[i, 1] * away
            for k in range(i + 1):
                P[i, k] -= K[i, 0] * PH[k, 0] + K[i, 1] * PH[k, 1]
                P[k, i] = P[i, k]
    return after


@compiled
def _difference(motion: Array, P: Array, before: Array, after: Array) -> tuple[float, ...]:
    """The difference of two lines that the motion does not explain: of α [rad] and of ρ [m], its covariance tt, ta, aa,
    and its D².

    S = H P Hᵀ + C + C', with a row (0, 0, 1) of H for the turn and (n, 0) for the distance.
    """
    c, s = math.cos(before[0]), math.sin(before[0])
    turn = wrap_angle(before[0] - after[0] - motion[2])
    away = before[1] - after[1] - c * motion[0] - s * motion[1]
    tt = P[2, 2] + before[2] + after[2]
    ta = c * P[0, 2] + s * P[1, 2] + before[3] + after[3]
    aa = c * c * P[0, 0] + 2.0 * c * s * P[0, 1] + s * s * P[1, 1] + before[4] + after[4]
    distance = (aa * turn * turn - 2.0 * ta * turn * away + tt * away * away) / (tt * aa - ta * ta)
    return turn, away, tt, ta, aa, distance
