"""Visibility of features: the probability of range, field of view, and line of sight over the explored grid.

These are probabilities, because neither feature nor robot is known exactly. With r, β the range and bearing of the
predicted position in R, σ_r along the line of sight and σ_t across it, and Φ the normal distribution function,

    P(in range) = Φ((range − r) / σ_r) − Φ((min_range − r) / σ_r),
    P(in the field) = Φ((α − β) / σ_β) − Φ((−α − β) / σ_β),  α half the field of view, σ_β = σ_t / r,
    P(in sight) = mean over rays of Π over the unknown cells crossed of τ^(length in it), and 0 through a wall.

The rays of one feature end at the quantiles 0.1, 0.3, 0.5, 0.7, 0.9 of its position across the line of sight, so that
a feature at the end of a wall, seen along the wall, is neither surely hidden nor surely in sight.
"""

import math
from dataclasses import dataclass

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import cells_along
from slam_gym.navigation.explored_grid import UNKNOWN, WALL, Cells, ExploredCells
from slam_gym.types import Array
from slam_gym.types._fields import compact

_QUANTILES = (-1.2815515655446004, -0.5244005127080407, 0.0, 0.5244005127080407, 1.2815515655446004)
_SHORT = 2.0  # [cells] lines of sight end this far before the feature, which may stand on a wall
_BLUR = 1.0  # [cells] σ of the position of a wall within the grid

SensorFigures = tuple[float, float, float, float]  # half the field of view [rad], least and greatest range, `unknown`
SightArrays = tuple[SensorFigures, tuple[Cells, Array, float]]  # and explored space: cells, origin [m], resolution [m]

NOTHING_EXPLORED = ExploredCells(np.empty((0, 0), np.uint8), np.zeros(2), 1.0)
"""In place of explored space: no wall hides anything."""


@dataclass(frozen=True, slots=True)
class ViewsFrom:
    """What a sensor has in view from any pose of the robot, as far as walls are known.

    Raises ValueError, naming the field, for an impossible value.
    """

    angle: float  # [rad] full angle of the field of view, centred on the heading
    range: float  # [m] greatest range
    min_range: float = 0.0  # [m] least range
    unknown: float = 0.9  # probability that a metre of unexplored space does not block a line of sight
    explored: ExploredCells = NOTHING_EXPLORED

    def __post_init__(self) -> None:
        if not 0.0 < self.angle <= 2.0 * math.pi:
            raise ValueError(f"ViewsFrom.angle: {self.angle} is not in (0, 2π] rad")
        if not 0.0 <= self.min_range < self.range < math.inf:
            given = f"{self.min_range} and {self.range}"
            raise ValueError(f"ViewsFrom.range: expected 0 <= min_range < range < ∞ [m], got {given}")
        if not 0.0 <= self.unknown <= 1.0:
            raise ValueError(f"ViewsFrom.unknown: {self.unknown} is not a probability")

    @property
    def arrays(self) -> SightArrays:
        """Sensor and explored space as plain tuples, which `probabilities_in_view` takes."""
        cells, origin, resolution = self.explored
        figures = 0.5 * self.angle, float(self.min_range), float(self.range), float(self.unknown)
        return figures, (compact(cells), compact(origin), resolution)


@compiled
def probabilities_in_view(positions: Array, covariances: Array, sight: SightArrays, pose: Array) -> Array:
    """The probability (k,) that each feature is in view; NaN for a feature with an invalid number.

    `positions` (k, 2) [m] and `covariances` (k, 2, 2) are in R; `pose` (3,) is that of the robot in B.
    """
    (sensor, explored), out = sight, np.empty(len(positions))
    (_, _, far, unknown), grid = sensor, ExploredCells(*explored)
    for j in range(len(positions)):
        x, y = positions[j, 0], positions[j, 1]
        xx, xy, yy = covariances[j, 0, 0], covariances[j, 0, 1], covariances[j, 1, 1]
        if not (math.isfinite(x + y + xx + xy + yy) and xx >= 0.0 and yy >= 0.0):
            out[j] = math.nan
            continue
        r = math.sqrt(x * x + y * y)
        c, s = (x / r, y / r) if r > 0.0 else (1.0, 0.0)
        along = math.sqrt(max(c * c * xx + 2.0 * c * s * xy + s * s * yy, 0.0))
        across = math.sqrt(max(s * s * xx - 2.0 * c * s * xy + c * c * yy, 0.0))
        out[j] = _in_field(r, math.atan2(y, x), along, across, sensor)
        if grid.cells.size > 0 and out[j] > 0.0:
            shorten = min(1.0, far / r) if r > 0.0 else 1.0  # whatever is seen is within the range
            out[j] *= _in_sight(grid, pose, shorten * x, shorten * y, across, unknown)
    return out


@compiled
def _below(z: float, sigma: float) -> float:
    """P(X < z) for X normal with mean 0 and standard deviation `sigma`."""
    if sigma > 0.0:
        return 0.5 * math.erfc(-z / (sigma * math.sqrt(2.0)))
    return 1.0 if z >= 0.0 else 0.0


@compiled
def _in_field(r: float, bearing: float, along: float, across: float, sensor: SensorFigures) -> float:
    """P(in range) · P(in the field of view)."""
    half, near, far, _ = sensor
    in_range = _below(far - r, along)
    if near > 0.0:
        in_range -= _below(near - r, along)
    if half >= math.pi:
        return in_range
    # beyond σ = π the bearing is nearly uniform, and three turns of the circle hold nearly all of its distribution
    sigma = min(across / r, math.pi) if r > 0.0 else math.pi
    in_field = 0.0
    for turn in range(-1, 2):
        to = bearing + 2.0 * math.pi * turn
        in_field += _below(half - to, sigma) - _below(-half - to, sigma)
    return in_range * min(in_field, 1.0)


@compiled
def _in_sight(grid: ExploredCells, pose: Array, x: float, y: float, across: float, unknown: float) -> float:
    """Mean `passage` of the rays from the robot at `pose` to possible positions of the feature at (x, y) [m] in R."""
    r = math.sqrt(x * x + y * y)
    if not r > 0.0:
        return 1.0
    c, s = math.cos(pose[2]), math.sin(pose[2])
    resolution = grid.resolution
    from_x, from_y = (pose[0] - grid.origin[0]) / resolution, (pose[1] - grid.origin[1]) / resolution
    spread = math.sqrt(across * across + (_BLUR * resolution) ** 2) / r
    tau, total = unknown**resolution, 0.0
    for quantile in _QUANTILES:
        u, v = x - quantile * spread * y, y + quantile * spread * x
        total += passage(grid.cells, from_x, from_y, (c * u - s * v) / resolution, (s * u + c * v) / resolution, tau)
    return total / len(_QUANTILES)


@compiled
def passage(cells: Cells, x: float, y: float, dx: float, dy: float, tau: float) -> float:
    """The probability that nothing blocks the ray from (x, y) by (dx, dy) [cells]: τ^(unknown length), 0 for a wall.

    The robot's own cell never blocks it. Outside the grid all cells are unknown.
    """
    length = math.sqrt(dx * dx + dy * dy)
    reach = length - _SHORT
    if not reach > 0.0:
        return 1.0
    (h, w), unknown_length, first = cells.shape, 0.0, True
    for row, column, r_in, r_out in cells_along(x, y, dx / length, dy / length, reach):
        inside = 0 <= row < h and 0 <= column < w
        rises_off = (row < 0 and dy <= 0.0) or (row >= h and dy >= 0.0)
        if rises_off or (column < 0 and dx <= 0.0) or (column >= w and dx >= 0.0):  # never enters the grid again
            return float(tau ** (unknown_length + reach - r_in))
        if inside and not first and cells[row, column] == WALL:
            return 0.0
        if not inside or cells[row, column] == UNKNOWN:
            unknown_length += r_out - r_in
        first = False
    return float(tau**unknown_length) if unknown_length > 0.0 else 1.0
