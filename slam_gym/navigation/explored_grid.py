"""What has been explored: a grid of free, wall and unknown cells, built from beams and the *estimated* poses."""

from __future__ import annotations

import numpy as np

from slam_gym.mapping.linear_algebra import read_only
from slam_gym.navigation import grid
from slam_gym.navigation.frontiers import Frontiers, find_frontiers
from slam_gym.navigation.grid import FREE, UNKNOWN, WALL, Cells, ExploredCells
from slam_gym.types import Array, Beams, BoolArray

__all__ = ["FREE", "UNKNOWN", "WALL", "Cells", "ExploredCells", "ExploredGrid", "Frontiers"]


class ExploredGrid:
    """Explored space within fixed bounds.

    Every cell holds saturating evidence, the integer form of log-odds: an echo counts +3, a beam crossing it −1, once a
    sweep. Its sign is the cell's class (a tie leaves the class as it was), and its saturation at ±8 lets new evidence
    overrule old after the pose estimate has been corrected, or a person has walked on.

    `bounds` (4,) [m] xmin, ymin, xmax, ymax in B; `resolution` [m] side of a cell. Cells are addressed [row, column];
    row 0 lies at ymin, column 0 at xmin. Raises ValueError for bounds that are not finite or enclose nothing, and for
    more than 20 million cells.
    """

    def __init__(self, bounds: Array, resolution: float = 0.2) -> None:
        shape = grid.shape_of(bounds, resolution)
        self.resolution = float(resolution)
        self.origin: Array = np.array(bounds[:2], dtype=np.float64)  # (2,) [m] in B
        self._cells = np.full(shape, UNKNOWN, dtype=np.uint8)
        self._blocks = np.zeros([-(-side // grid.BLOCK) for side in shape], dtype=np.int16)
        evidence, sweeps = np.zeros(shape, dtype=np.int8), np.zeros(shape, dtype=np.int32)
        hits, crossings = np.zeros(shape, dtype=np.uint32), np.zeros(shape, dtype=np.uint32)
        touched = np.empty(shape[0] * shape[1], dtype=np.int32)
        self._layers: grid.PackedLayers = (self._cells, evidence, self._blocks, sweeps, hits, crossings, touched)
        self._sweep = 0  # number of the last one

    @property
    def cells(self) -> Cells:
        """Class of every cell (h, w): UNKNOWN, FREE or WALL. Of the live grid, read-only."""
        return read_only(self._cells)

    @property
    def explored(self) -> ExploredCells:
        """The cells and where they lie: what may be handed on to be looked at, but not changed."""
        return ExploredCells(self.cells, read_only(self.origin), self.resolution)

    @property
    def drawn(self) -> tuple[grid.Blocks, Array, float]:
        """What `grid.draw_egocentric` draws: blocks of cells, themselves, their origin and the side of a cell."""
        return self._blocks, self.origin, self.resolution

    def integrate(self, pose: Array, beams: Beams, movable: bool = False) -> None:
        """Enter one sweep of the range finder, taken at the estimated `pose` (3,) in B.

        Beams at `max_range` had no echo. Readings that are negative or not a number are ignored, as is whatever falls
        outside the bounds. Only a sweep that is `movable` can be moved later: it is counted in each of its cells.
        Raises ValueError for a pose that is not three finite numbers.
        """
        if len(pose) != 3:
            raise ValueError(f"pose: expected (3,), got {pose}")
        self._sweep += 1
        grid.integrate(
            self._layers, self._sweep, movable, self.origin, self.resolution, pose,
            (beams.bearings, beams.ranges, beams.max_range),
        )  # fmt: skip

    def move(self, before: Array, after: Array, beams: Beams) -> None:
        """Move movable sweeps, with `beams.ranges` (k, b), from the poses `before` (k, 3) to `after` (k, 3), both in B.

        Not a number as a pose stands for "not in the grid": sweeps can so be taken out, and put in again. Where that
        changes what a cell was seen to be, its class follows from all movable sweeps that it is in, in whatever order.
        """
        first, self._sweep = self._sweep + 1, self._sweep + 2 * len(before)
        grid.redraw(
            self._layers, first, self.origin, self.resolution, (before, after, beams.ranges), beams.bearings,
            beams.max_range,
        )  # fmt: skip

    def frontiers(self, reachable: BoolArray | None = None, min_length: float = 0.6, span: float = 3.0) -> Frontiers:
        """Frontiers at least `min_length` [m] long: connected free cells with an unknown cell beside them.

        A frontier reaching further than `span` [m] from its first cell is split there, since one centre could not
        stand for all of it. A centre is the `reachable` (h, w) cell nearest to the frontier's centroid; frontiers
        without one are left out. By default every free cell counts as reachable.
        """
        if reachable is None:
            reachable = self._cells == FREE
        borders = min_length / self.resolution - 1e-9
        found = find_frontiers(self._cells, reachable, borders, span / self.resolution).astype(np.float64)
        return Frontiers(self.origin + (found[:, :2] + 0.5) * self.resolution, found[:, 2] * self.resolution)

    def expected_area(self, points: Array, reach: float, rays: int = 32) -> Array:
        """Unknown area [m²] (q,) within `reach` [m] of each of `points` (q, 2) in B, in view past the known walls.

        Integrates ∫∫ r dr dθ over the unknown stretches of `rays` evenly spaced rays.
        """
        points = (np.ascontiguousarray(points, dtype=np.float64) - self.origin) / self.resolution
        return grid.unknown_areas(self._cells, points, reach / self.resolution, rays) * self.resolution**2

    def egocentric(self, pose: Array, features: Array, pixels: int = 48, metres: float = 24.0) -> Cells:
        """The grid around the robot at `pose` (3,) in B, heading up, its left on the left: (3, pixels, pixels).

        Planes: free space (255 = all of the pixel), walls (255 = a quarter of the pixel or more, walls being thin) and
        density of `features` (n, 2) in B (85 each, at most 255). The image covers `metres` × `metres` [m].
        """
        image = np.empty((3, pixels, pixels), np.uint8)
        grid.draw_egocentric(*self.drawn, pose, np.ascontiguousarray(features), metres, image)
        return image
