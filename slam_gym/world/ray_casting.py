"""Line of sight over thousands of walls: a uniform grid of cells, each with the walls that touch it, walked by rays.

A ray visits cells in the order in which it crosses them (the digital differential analyser of Amanatides and Woo, "A
fast voxel traversal algorithm for ray tracing", 1987) and stops at the first cell that holds its nearest hit, so its
cost depends on how far it flies and how dense the walls are there, not on how many walls the building has. Whatever
moves (people, furniture) is few and tested one by one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.types import Array, BoolArray
from slam_gym.world.floor_plan import Features, Kind
from slam_gym.world.wall_grid import PADDING, Grid, Packed, wall_grid

NO_DISCS: Array = np.empty((0, 3))
NO_SEGMENTS: Array = np.empty((0, 4))

_SURFACE = 1e-3  # [m] how far before a feature a line of sight ends, so that the feature's own walls do not hide it


class Movers(NamedTuple):
    """What moves."""

    discs: Array  # (d, 3) [m] x y radius
    segments: Array  # (o, 4) [m] x1 y1 x2 y2


class WallIndex:
    """Static walls, indexed once, then asked for ranges and lines of sight from anywhere.

    `walls` (s, 4) [m] are segments `x1 y1 x2 y2` in any one frame, which is then the frame of all questions; `cell`
    [m] is the side of the grid's cells (doubled until a million of them suffice). Raises ValueError where walls are
    not finite or of another shape, or `cell` is not positive.
    """

    def __init__(self, walls: Array, cell: float = 1.0) -> None:
        self.packed = wall_grid(walls, cell)

    def __len__(self) -> int:
        return len(self.packed[0])

    def cast(
        self, origin: Array, angles: Array, max_range: float, discs: Array = NO_DISCS, segments: Array = NO_SEGMENTS
    ) -> Array:
        """Ranges (b,) [m] from `origin` (2,) along `angles` (b,) [rad] to the first surface, at most `max_range`.

        `discs` (d, 3) [m] `x y radius` and `segments` (o, 4) [m] stop a ray as walls do. A disc around the origin is
        not seen from within.
        """
        return cast(self.packed, origin, angles, max_range, (discs, segments))

    def visible(
        self, origin: Array, targets: Array, pull_back: Array, discs: Array = NO_DISCS, segments: Array = NO_SEGMENTS
    ) -> BoolArray:
        """(k,) whether nothing stands between `origin` (2,) and each of `targets` (k, 2).

        The line of sight ends `pull_back` (k,) [m] short of its target, outside the thing whose position it is.
        """
        return _visible(self.packed, origin, targets, pull_back, (discs, segments))


def pull_back(features: Features) -> Array:
    """(N,) [m] how far before its position each feature is met: corners at once, pillars at their outline."""
    return np.where(features.kinds == Kind.PILLAR, 0.5 * features.sizes, 0.0) + _SURFACE


@compiled
def _segment_hit(x: float, y: float, dx: float, dy: float, segments: Array, s: int) -> float:
    """t in [0, 1] at which (x, y) + t (dx, dy) crosses row s of segments (…, 4), or its ends; inf where it does not."""
    ax, ay, bx, by = segments[s, 0] - x, segments[s, 1] - y, segments[s, 2] - x, segments[s, 3] - y
    if (dx * ay - dy * ax) * (dx * by - dy * bx) > 0.0:  # both ends on one side of the ray
        return math.inf
    ex, ey = bx - ax, by - ay
    t = (ax * ey - ay * ex) / (dx * ey - dy * ex)
    return t if 0.0 <= t <= 1.0 else math.inf  # NaN where parallel


@compiled
def _disc_hit(x: float, y: float, dx: float, dy: float, disc: Array) -> float:
    """t in [0, 1] at which (x, y) + t (dx, dy) enters a disc (3,); inf where it does not, or starts within."""
    cx, cy, radius = x - disc[0], y - disc[1], disc[2]
    a, b, c = dx * dx + dy * dy, dx * cx + dy * cy, cx * cx + cy * cy - radius * radius
    root = b * b - a * c
    if root < 0.0:
        return math.inf
    t = (-b - math.sqrt(root)) / a
    return t if 0.0 <= t <= 1.0 else math.inf


@compiled
def _entry(grid: Grid, x: float, y: float, dx: float, dy: float) -> float:
    """t in [0, 1] at which the ray enters the grid's rectangle, 0 from within; inf where it never does."""
    if 0.0 <= x - grid.xmin < grid.cell * grid.columns and 0.0 <= y - grid.ymin < grid.cell * grid.rows:
        return 0.0
    enter, leave = 0.0, 1.0
    pad = PADDING * grid.cell
    for axis in range(2):
        p, d = (x, dx) if axis == 0 else (y, dy)
        low = grid.xmin if axis == 0 else grid.ymin
        high = low + grid.cell * (grid.columns if axis == 0 else grid.rows) + pad
        low -= pad
        if d == 0.0:
            if p < low or p > high:
                return math.inf
        else:
            enter = max(enter, min((low - p) / d, (high - p) / d))
            leave = min(leave, max((low - p) / d, (high - p) / d))
    return enter if enter <= leave else math.inf


@compiled
def _wall_hit(grid: Grid, x: float, y: float, dx: float, dy: float) -> float:
    """Least t in [0, 1] at which (x, y) + t (dx, dy) meets a wall; inf where it meets none."""
    enter, nearest = _entry(grid, x, y, dx, dy), math.inf
    if enter == math.inf:
        return nearest
    column = math.floor((x + enter * dx - grid.xmin) / grid.cell)
    row = math.floor((y + enter * dy - grid.ymin) / grid.cell)
    column, row = min(max(column, 0), grid.columns - 1), min(max(row, 0), grid.rows - 1)
    step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_x = next_y = across_x = across_y = math.inf  # t at the next border, t from border to border
    if dx != 0.0:
        next_x = (grid.xmin + (column + (dx > 0.0)) * grid.cell - x) / dx
        across_x = grid.cell / abs(dx)
    if dy != 0.0:
        next_y = (grid.ymin + (row + (dy > 0.0)) * grid.cell - y) / dy
        across_y = grid.cell / abs(dy)
    while 0 <= column < grid.columns and 0 <= row < grid.rows:
        c = row * grid.columns + column
        for k in range(grid.starts[c], grid.starts[c + 1]):
            nearest = min(nearest, _segment_hit(x, y, dx, dy, grid.walls, grid.members[k]))
        leave = min(next_x, next_y)
        if nearest <= leave or leave > 1.0:
            break
        if next_x < next_y:
            column, next_x = column + step_x, next_x + across_x
        else:
            row, next_y = row + step_y, next_y + across_y
    return nearest


@compiled
def _mover_hit(x: float, y: float, dx: float, dy: float, movers: Movers) -> float:
    """As `_wall_hit`, for the few things that move."""
    nearest = math.inf
    for d in range(movers.discs.shape[0]):
        nearest = min(nearest, _disc_hit(x, y, dx, dy, movers.discs[d]))
    for s in range(movers.segments.shape[0]):
        nearest = min(nearest, _segment_hit(x, y, dx, dy, movers.segments, s))
    return nearest


@compiled
def squared_distance(x: float, y: float, segments: Array, s: int) -> float:
    """[m²] from a point to row s of segments (…, 4)."""
    ax, ay = segments[s, 0] - x, segments[s, 1] - y
    ex, ey = segments[s, 2] - segments[s, 0], segments[s, 3] - segments[s, 1]
    length = ex * ex + ey * ey
    t = min(max(-(ax * ex + ay * ey) / length, 0.0), 1.0) if length > 0.0 else 0.0
    dx, dy = ax + t * ex, ay + t * ey
    return float(dx * dx + dy * dy)


@compiled
def movers_near(x: float, y: float, reach: float, movers: Movers) -> Movers:
    """Those that come within `reach` [m] of (x, y)."""
    discs, segments = np.empty(movers.discs.shape), np.empty(movers.segments.shape)
    d = s = 0
    for disc in movers.discs:
        if math.hypot(disc[0] - x, disc[1] - y) <= reach + disc[2]:
            discs[d, 0], discs[d, 1], discs[d, 2] = disc[0], disc[1], disc[2]
            d += 1
    for k in range(len(movers.segments)):
        if squared_distance(x, y, movers.segments, k) <= reach * reach:
            for end in range(4):
                segments[s, end] = movers.segments[k, end]
            s += 1
    return Movers(discs[:d], segments[:s])


@compiled
def _shortened(dx: float, dy: float, pull_back: float) -> float:
    """The fraction of (dx, dy) that is left when it ends `pull_back` [m] earlier; 0 where nothing is left."""
    distance = math.hypot(dx, dy)
    return 1.0 - pull_back / distance if distance > pull_back else 0.0


@compiled
def sees(grid: Grid, x: float, y: float, dx: float, dy: float, pull_back: float) -> bool:
    """Whether no wall stands between (x, y) and (x, y) + (dx, dy), the latter `pull_back` [m] nearer."""
    left = _shortened(dx, dy, pull_back)
    return _wall_hit(grid, x, y, left * dx, left * dy) == math.inf


@compiled
def hides(x: float, y: float, dx: float, dy: float, pull_back: float, movers: Movers) -> bool:
    """Whether one of `movers` stands on the line of sight that `sees` asks the walls about."""
    left = _shortened(dx, dy, pull_back)
    return _mover_hit(x, y, left * dx, left * dy, movers) < math.inf


@compiled
def range_along(grid: Grid, x: float, y: float, angle: float, max_range: float, movers: Movers) -> float:
    """[m] from (x, y) along `angle` [rad] to the first surface, at most `max_range`."""
    dx, dy = max_range * math.cos(angle), max_range * math.sin(angle)
    t = min(_wall_hit(grid, x, y, dx, dy), _mover_hit(x, y, dx, dy, movers))
    return max_range * min(t, 1.0)


@compiled
def cast(packed: Packed, origin: Array, angles: Array, max_range: float, moving: tuple[Array, Array]) -> Array:
    """See `WallIndex.cast`; `moving` are the arrays of `Movers`."""
    grid, x, y = Grid(*packed), origin[0], origin[1]
    movers = movers_near(x, y, max_range, Movers(*moving))
    ranges = np.empty(angles.shape[0])
    for b in range(angles.shape[0]):
        ranges[b] = range_along(grid, x, y, angles[b], max_range, movers)
    return ranges


@compiled
def _visible(packed: Packed, origin: Array, targets: Array, pull_back: Array, moving: tuple[Array, Array]) -> BoolArray:
    grid, x, y, reach = Grid(*packed), origin[0], origin[1], 0.0
    for i in range(targets.shape[0]):
        reach = max(reach, math.hypot(targets[i, 0] - x, targets[i, 1] - y))
    movers, seen = movers_near(x, y, reach, Movers(*moving)), np.empty(targets.shape[0], np.bool_)
    for i in range(targets.shape[0]):
        dx, dy, short = targets[i, 0] - x, targets[i, 1] - y, pull_back[i]
        seen[i] = sees(grid, x, y, dx, dy, short) and not hides(x, y, dx, dy, short, movers)
    return seen
