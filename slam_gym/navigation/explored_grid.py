"""The explored grid: free, wall and unknown cells, built from beams and the *estimated* poses.

Cells are addressed [row, column]; row 0 is at the lowest y, column 0 at the lowest x, both at the grid's `origin`. The
loops over the grid are compiled.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym._jit import compiled
from slam_gym.geometry import cells_along
from slam_gym.types import Array, Beams
from slam_gym.types._fields import locked

UNKNOWN, FREE, WALL = 0, 1, 2

Cells = NDArray[np.uint8]  # (h, w) class of each cell
Blocks = NDArray[np.int16]  # (⌈h/2⌉, ⌈w/2⌉) free cells + 256 · wall cells of each block of 2 × 2

HIT, MISS = np.int64(3), np.int64(-1)  # evidence of one sweep for a cell with an echo, and for a cell that beams cross
SATURATION = 8  # greatest |evidence|, so that nine crossings clear a wall that is no longer there
BLOCK = 2  # side of a block in cells
SHADE = 85  # brightness that one feature adds to its pixel
_MAX_CELLS = 20_000_000


def shape_of(bounds: Array, cell: float) -> tuple[int, int]:
    """Rows and columns of a grid over `bounds` (4,) [m] xmin, ymin, xmax, ymax, with cells of side `cell` [m].

    Raises ValueError for bounds that are not finite or have no area, for a side that is not finite and positive, and
    for more than 20 million cells.
    """
    bounds = np.array(bounds, dtype=np.float64)
    if bounds.shape != (4,) or not np.isfinite(bounds).all() or (bounds[2:] <= bounds[:2]).any():
        raise ValueError(f"bounds: expected finite xmin < xmax and ymin < ymax [m], got {bounds.tolist()}")
    if not 0.0 < cell < math.inf:
        raise ValueError(f"side of a cell: expected a finite length > 0 [m], got {cell}")
    width, height = np.ceil((bounds[2:] - bounds[:2]) / cell - 1e-9)
    if width * height > _MAX_CELLS:
        size = f"{width:.0f} × {height:.0f} cells of {cell:g} m"
        raise ValueError(f"bounds: {size} are more than {_MAX_CELLS}; a coarser `grid_resolution` has fewer")
    return int(height), int(width)


class ExploredCells(NamedTuple):
    """A read-only view of free, wall and unknown cells."""

    cells: Cells
    origin: Array  # (2,) [m] in B of the lower left corner
    resolution: float  # [m] side of a cell


class ExploredGrid:
    """Explored space within fixed bounds.

    Every cell has saturating evidence, the integer form of log-odds: in each sweep, an echo counts +3, and a crossing
    beam −1. The sign of the evidence is the cell's class (zero leaves the class unchanged). Because it saturates at ±8,
    new evidence overrules old after the pose estimate has been corrected, or a person has walked on.

    `bounds` (4,) [m] xmin, ymin, xmax, ymax in B; `resolution` [m] side of a cell. Raises ValueError as `shape_of`.
    """

    def __init__(self, bounds: Array, resolution: float = 0.2) -> None:
        shape = shape_of(bounds, resolution)
        self.resolution = float(resolution)
        self.origin = locked(np.array(bounds[:2], dtype=np.float64))  # (2,) [m] in B
        self._cells = np.full(shape, UNKNOWN, dtype=np.uint8)
        self._blocks = np.zeros([-(-side // BLOCK) for side in shape], dtype=np.int16)
        evidence, sweeps = np.zeros(shape, dtype=np.int8), np.zeros(shape, dtype=np.int32)
        hits, crossings = np.zeros(shape, dtype=np.uint32), np.zeros(shape, dtype=np.uint32)
        touched = np.empty(shape[0] * shape[1], dtype=np.int32)
        layers = self._cells, evidence, self._blocks, sweeps, hits, crossings, touched, self.origin, self.resolution
        self._layers: PackedLayers = layers
        self._sweep = 0  # number of the last sweep

    @property
    def cells(self) -> Cells:
        """Class of every cell (h, w): UNKNOWN, FREE or WALL. A read-only view, which changes with the grid."""
        return locked(self._cells)

    @property
    def explored(self) -> ExploredCells:
        """The cells, as a read-only view that changes with the grid, their origin and their side."""
        return ExploredCells(self.cells, self.origin, self.resolution)

    @property
    def drawn(self) -> tuple[Blocks, Array, float]:
        """The arguments of `draw_egocentric`: blocks of cells (not copied), their origin, and the side of a cell."""
        return self._blocks, self.origin, self.resolution

    def integrate(self, pose: Array, beams: Beams, movable: bool = False) -> None:
        """Enter one sweep of the range finder, taken at the estimated `pose` (3,) in B.

        Beams at `max_range` had no echo. Readings that are negative or not a number are ignored, as are cells outside
        the bounds. Only a `movable` sweep can be moved later: it is counted in each of its cells.
        Raises ValueError for a pose that is not three finite numbers.
        """
        if len(pose) != 3:
            raise ValueError(f"pose: expected (3,), got {pose}")
        self._sweep += 1
        _integrate(self._layers, self._sweep, movable, pose, (beams.bearings, beams.ranges, beams.max_range))

    def move(self, before: Array, after: Array, beams: Beams) -> None:
        """Move movable sweeps, with `beams.ranges` (k, b), from the poses `before` (k, 3) to `after` (k, 3), both in B.

        A pose of NaN means "not in the grid", so that sweeps can be removed and entered again. Where the counts of a
        cell change, its class follows from all movable sweeps that touch it, whatever their order.
        """
        first, self._sweep = self._sweep + 1, self._sweep + 2 * len(before)
        _redraw(self._layers, first, before, after, (beams.bearings, beams.ranges, beams.max_range))

    def expected_area(self, points: Array, reach: float, rays: int = 32) -> Array:
        """(q,) [m²] unknown area within `reach` [m] of each of `points` (q, 2) in B that no known wall hides.

        Integrates ∫∫ r dr dθ over the unknown parts of `rays` evenly spaced rays.
        """
        points = (np.ascontiguousarray(points, dtype=np.float64) - self.origin) / self.resolution
        return _unknown_areas(self._cells, points, reach / self.resolution, rays) * self.resolution**2

    def egocentric(self, pose: Array, features: Array, pixels: int = 48, metres: float = 24.0) -> Cells:
        """(3, pixels, pixels) image of the grid around the robot at `pose` (3,) in B, with its heading upwards.

        Channels: free space (255 = all of the pixel), walls (255 = a quarter of the pixel or more, because walls are
        thin) and density of `features` (n, 2) in B (85 each, at most 255). It covers `metres` × `metres` [m].
        """
        image = np.empty((3, pixels, pixels), np.uint8)
        draw_egocentric(*self.drawn, pose, np.ascontiguousarray(features), metres, image)
        return image


class Layers(NamedTuple):
    """The data of every cell, and where the cells are."""

    cells: Cells
    evidence: NDArray[np.int8]  # (h, w) > 0: for a wall; < 0: for free space
    blocks: Blocks
    sweeps: NDArray[np.int32]  # (h, w) number of the sweep that last touched each cell
    hits: NDArray[np.uint32]  # (h, w) number of movable sweeps with an echo in each cell
    crossings: NDArray[np.uint32]  # (h, w) number of movable sweeps that crossed each cell
    touched: NDArray[np.int32]  # (h · w,) working memory: flat indices of cells
    origin: Array  # (2,) [m] in B
    resolution: float  # [m]


PackedLayers = tuple[Any, ...]
"""`Layers` as a plain tuple, which compiled functions take."""

Sweep = tuple[Array, Array, float]
"""The fields of `Beams`, as compiled functions take them."""


@compiled
def _trace(layers: Layers, number: int, pose: Array, sweep: Sweep) -> tuple[int, int]:
    """Enter the flat index of each cell of one sweep in `touched`; returns the number of echoes, and of all cells.

    Cells with an echo come first, so that no beam of the same sweep that crosses them erases them. No earlier sweep had
    this `number`.
    """
    sweeps, touched, origin, resolution = layers.sweeps, layers.touched, layers.origin, layers.resolution
    (h, w), (bearings, ranges, max_range) = sweeps.shape, sweep
    x, y = (pose[0] - origin[0]) / resolution, (pose[1] - origin[1]) / resolution
    count, directions = 0, np.empty((bearings.shape[0], 2))
    for b in range(bearings.shape[0]):
        directions[b, 0], directions[b, 1] = math.cos(pose[2] + bearings[b]), math.sin(pose[2] + bearings[b])
        if 0.0 <= ranges[b] < max_range:
            column = math.floor(x + ranges[b] / resolution * directions[b, 0])
            row = math.floor(y + ranges[b] / resolution * directions[b, 1])
            if 0 <= row < h and 0 <= column < w and sweeps[row, column] != number:
                sweeps[row, column] = number
                touched[count] = row * w + column
                count += 1
    echoes = count
    for b in range(bearings.shape[0]):
        if not ranges[b] >= 0.0:
            continue
        reach = min(ranges[b], max_range) / resolution
        for row, column, _, _ in cells_along(x, y, directions[b, 0], directions[b, 1], reach):
            if not (0 <= row < h and 0 <= column < w):
                break
            if sweeps[row, column] != number:
                sweeps[row, column] = number
                touched[count] = row * w + column
                count += 1
    return echoes, count


@compiled
def _reclassify(layers: Layers, cell: int, after: int) -> None:
    """Change the class of the cell with flat index `cell` to `after`."""
    w = layers.cells.shape[1]
    row, column = cell // w, cell % w
    before = layers.cells[row, column]
    layers.cells[row, column] = after
    freed = int(after == FREE) - int(before == FREE)
    walled = int(after == WALL) - int(before == WALL)
    layers.blocks[row // BLOCK, column // BLOCK] += freed + 256 * walled


@compiled
def _integrate(packed: PackedLayers, number: int, counted: bool, pose: Array, sweep: Sweep) -> None:
    """Enter one sweep: see `ExploredGrid.integrate`. A sweep that is `counted` can be moved later."""
    if not math.isfinite(pose[0] + pose[1] + pose[2]):
        raise ValueError("pose: expected finite numbers")
    layers = Layers(*packed)
    cells, evidence, touched = layers.cells.ravel(), layers.evidence.ravel(), layers.touched
    hits, crossings = layers.hits.ravel(), layers.crossings.ravel()
    echoes, end = _trace(layers, number, pose, sweep)
    if counted:
        for i in range(echoes):
            hits[touched[i]] += 1
        for i in range(echoes, end):
            crossings[touched[i]] += 1
    for i in range(end):
        cell = touched[i]
        if i >= echoes and evidence[cell] == -SATURATION:  # cannot become freer
            continue
        weight = min(SATURATION, max(-SATURATION, evidence[cell] + (HIT if i < echoes else MISS)))
        evidence[cell] = weight
        after = FREE if weight < 0 else WALL
        if weight != 0 and cells[cell] != after:
            _reclassify(layers, cell, after)


@compiled
def _redraw(packed: PackedLayers, first: int, before: Array, after: Array, swept: Sweep) -> None:
    """Move counted sweeps, with ranges (k, b), from the poses `before` (k, 3) to the poses `after` (k, 3).

    A pose of NaN means that the sweep is not in the grid. Evidence saturates and cannot be subtracted, but the counts
    can. Where these change, evidence and class are computed from the counts alone, whatever the order of the sweeps.
    The sweep numbers from `first` to `first` + 2k − 1 are used up.
    """
    layers, (bearings, ranges, max_range) = Layers(*packed), swept
    size, number, changed, touched = layers.cells.size, first, 0, layers.touched
    hits, crossings = layers.hits.ravel(), layers.crossings.ravel()
    marked, journal = np.zeros(size, np.bool_), np.empty(size, np.int32)
    old_hits, old_crossings = np.empty(size, hits.dtype), np.empty(size, crossings.dtype)
    for k in range(len(ranges)):
        for pose, is_added in ((before[k], False), (after[k], True)):
            if math.isnan(pose[0]):
                continue
            echoes, end = _trace(layers, number, pose, (bearings, ranges[k], max_range))
            number += 1
            for i in range(end):
                cell = touched[i]
                if not marked[cell]:
                    marked[cell], journal[changed] = True, cell
                    old_hits[changed], old_crossings[changed] = hits[cell], crossings[cell]
                    changed += 1
                counts = hits if i < echoes else crossings
                if is_added:
                    counts[cell] += 1
                else:
                    counts[cell] -= 1
    for i in range(changed):
        cell = journal[i]
        if hits[cell] == old_hits[i] and crossings[cell] == old_crossings[i]:
            continue
        weight = int(HIT) * int(hits[cell]) + int(MISS) * int(crossings[cell])
        layers.evidence.ravel()[cell] = min(SATURATION, max(-SATURATION, weight))
        new_class = UNKNOWN if hits[cell] + crossings[cell] == 0 else (WALL if weight > 0 else FREE)
        if layers.cells.ravel()[cell] != new_class:
            _reclassify(layers, cell, new_class)


@compiled
def _unknown_areas(cells: Cells, points: Array, reach: float, rays: int) -> Array:
    """(q,) [cells²] unknown area in view of points (q, 2) [cells]: Σ over rays of Δθ (r₂² − r₁²)/2 per unknown cell."""
    h, w = cells.shape
    areas = np.zeros(points.shape[0])
    for k in range(rays):
        angle = 2.0 * math.pi * (k + 0.5) / rays
        dx, dy = math.cos(angle), math.sin(angle)
        for q in range(points.shape[0]):
            for row, column, r_in, r_out in cells_along(points[q, 0], points[q, 1], dx, dy, reach):
                if not (0 <= row < h and 0 <= column < w) or cells[row, column] == WALL:
                    break
                if cells[row, column] == UNKNOWN:
                    areas[q] += (r_out * r_out - r_in * r_in) * math.pi / rays
    return areas


@compiled
def draw_egocentric(
    blocks: Blocks, origin: Array, resolution: float, pose: Array, features: Array, metres: float, image: Cells
) -> None:
    """Draw the image of `ExploredGrid.egocentric` into `image` (3, pixels, pixels).

    Each pixel takes two staggered samples of the blocks, so that few thin walls are missed. Block indices advance in
    fixed point, with 16 bits after the point.
    """
    h, w, pixels = blocks.shape[0], blocks.shape[1], image.shape[1]
    unit, pixel = 65536.0 / (resolution * BLOCK), metres / pixels
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    step_x, step_y = int(sin * pixel * unit), int(-cos * pixel * unit)  # from a pixel to the one on its right
    sums = np.empty(pixels, dtype=np.int32)
    for row in range(pixels):
        sums[:] = 0
        for quarter in (0.25, 0.75):
            ahead, left = metres / 2.0 - (row + quarter) * pixel, metres / 2.0 - quarter * pixel
            x = math.floor((pose[0] + cos * ahead - sin * left - origin[0]) * unit)
            y = math.floor((pose[1] + sin * ahead + cos * left - origin[1]) * unit)
            far_x, far_y = x + (pixels - 1) * step_x, y + (pixels - 1) * step_y
            if max(x, far_x) < 0 or max(y, far_y) < 0 or min(x, far_x) >> 16 >= w or min(y, far_y) >> 16 >= h:
                continue  # the whole row lies outside
            if min(x, far_x) >= 0 and min(y, far_y) >= 0 and max(x, far_x) >> 16 < w and max(y, far_y) >> 16 < h:
                for i in range(pixels):
                    sums[i] += blocks[np.uint64(y >> 16), np.uint64(x >> 16)]  # unsigned: no test for negative indices
                    x, y = x + step_x, y + step_y
                continue
            for i in range(pixels):
                r, c = y >> 16, x >> 16
                if 0 <= r < h and 0 <= c < w:
                    sums[i] += blocks[r, c]
                x, y = x + step_x, y + step_y
        for i in range(pixels):
            image[0, row, i] = (sums[i] & 255) * 255 >> 3
            image[1, row, i] = min(255, (sums[i] >> 8) * 64)
            image[2, row, i] = 0
    for j in range(features.shape[0]):
        dx, dy = features[j, 0] - pose[0], features[j, 1] - pose[1]
        row = math.floor((metres / 2.0 - cos * dx - sin * dy) / pixel)
        column = math.floor((metres / 2.0 + sin * dx - cos * dy) / pixel)
        if 0 <= row < pixels and 0 <= column < pixels:
            image[2, row, column] = min(255, image[2, row, column] + SHADE)
