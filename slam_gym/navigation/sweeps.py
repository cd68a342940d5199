"""Sweeps that hang on the map, so that explored space is redrawn as the estimate is corrected and no wall stands twice.

A key pose is opened every half metre or 20°, and where the map has been corrected; it stands for the sweeps taken
until the next one. When it has moved by half a cell, they are taken out of the grid and put in again, moved like it.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.key_poses import KeyPoses, Moved
from slam_gym.types import Array, Beams, IntArray

SPACING, TURN = 0.5, math.radians(20.0)  # [m], [rad] between key poses
REST = 0.1  # of that: the robot counts as at rest, and but one of its sweeps there is kept
CHECK, SHARES = 10, 2  # every so many sweeps, one in so many key poses is looked at, and the last one, …
SURPRISE, SURPRISING_TURN = 0.1, math.radians(2.0)  # … or where a scan corrects the pose by so much [m], [rad]
AT_ONCE, ALLOWANCE = 3_000, 4  # sweeps that are redrawn at most, and by how many more with each that is entered
MOST = 30_000  # sweeps that are kept; when there are more, every other one is given up
NO_PAIRS = np.empty((0, 2), np.int64)


_Pose = tuple[float, float, float]  # x, y [m] and heading [rad] in B: plain numbers, since they are new at every tick
_NOWHERE: _Pose = (math.inf, 0.0, 0.0)


class Features(Protocol):
    """The features of a map, by ids that are never given twice."""

    @property
    def ids(self) -> IntArray:
        """(n,)"""

    @property
    def positions(self) -> Array:
        """(n, 2) [m] in B."""


class MovableSweeps:
    """Enters sweeps of one range finder into an explored grid, and moves them as the map is corrected."""

    def __init__(self, grid: ExploredGrid) -> None:
        self._grid = grid
        self._keys = KeyPoses()
        self._first: list[int] = []  # sweep of each key pose
        self._count = 0  # sweeps that are kept, one row each in …
        self._poses, self._ranges = np.empty((0, 3)), np.empty((0, 0))  # … in B as drawn last, and [m]
        self._last = self._kept = self._opened = _NOWHERE  # of the last sweep, the last one kept, the last key pose
        self._checks, self._unchecked, self._allowed = 0, 0, AT_ONCE

    def enter(
        self,
        pose: Array,
        motion: Array,
        beams: Beams,
        seen: IntArray,
        features: Features,
        fused: IntArray = NO_PAIRS,
    ) -> None:
        """Enter a sweep taken at the estimated `pose` (3,) in B, and move those before it to where they are now.

        `motion` (3,) is what the odometry says of the way since the last sweep; `seen` (s,) are the ids of features
        that were seen with this one, `features` all that are in the map now, `fused` (k, 2) the ids of pairs that have
        become one since, the one that is kept first. Raises ValueError for a pose that is not finite, or another number
        of beams than before.
        """
        x, y, heading = here = pose.tolist()
        if not math.isfinite(x + y + heading):
            raise ValueError(f"pose: expected finite numbers, got {pose}")
        if self._count and len(beams.ranges) != self._ranges.shape[1]:
            raise ValueError(f"beams: {len(beams.ranges)} of them, where sweeps so far had {self._ranges.shape[1]}")
        surprised = _apart(here, _moved(self._last, motion), SURPRISE, SURPRISING_TURN)
        self._last, self._unchecked, corrected = here, self._unchecked + 1, False
        self._allowed = min(self._allowed + ALLOWANCE, AT_ONCE)
        if len(fused):
            self._keys.fuse(fused)
        if self._first and (surprised or len(fused) or self._unchecked == CHECK):
            corrected = self._follow(beams, features.ids, features.positions)
        if corrected or _apart(here, self._opened, SPACING, TURN):
            self._keys.open(pose, seen, features.ids, features.positions)
            self._first.append(self._count)
            self._opened = here
        kept = _apart(here, self._kept, REST * SPACING, REST * TURN)
        self._grid.integrate(pose, beams, movable=kept)
        if kept:
            self._kept = here
            self._keep(pose, beams)

    def _follow(self, beams: Beams, ids: IntArray, positions: Array) -> bool:
        """Move the sweeps of key poses that have moved: of a share of them, and of all where the last one has.

        Returns whether it has: what is seen from now on is not seen from there.
        """
        last, share = len(self._keys) - 1, self._checks % SHARES
        self._checks, self._unchecked = self._checks + 1, 0
        at = (ids, positions, beams.max_range, 0.5 * self._grid.resolution)
        rows = np.arange(share, last + SHARES, SHARES)
        rows[-1] = last
        moved = self._keys.moved(rows, *at)
        corrected = len(moved.rows) > 0 and bool(moved.rows[-1] == last)
        if corrected:
            moved = self._keys.moved(np.arange(last + 1), *at)
        if len(moved.rows):
            self._redraw(moved, beams)
        return corrected

    def _redraw(self, moved: Moved, beams: Beams) -> None:
        """Take the sweeps of key poses out of the grid, and put them in where they are now.

        A map that moves all the time must not stop the robot: the youngest come first, others when they are looked at
        next.
        """
        ends = np.append(self._first, self._count)
        counts = ends[moved.rows + 1] - ends[moved.rows]
        first = int(np.searchsorted(-np.cumsum(counts[::-1])[::-1], -self._allowed))
        moved, counts = Moved(moved.rows[first:], moved.before[first:], moved.after[first:]), counts[first:]
        self._allowed -= int(counts.sum())
        if not len(counts):
            return
        sweeps = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in moved.rows])
        before, after = self._taken_along(moved, sweeps, counts)
        self._grid.move(before, after, Beams(beams.bearings, self._ranges[sweeps], beams.max_range))
        there = np.isfinite(after[:, 0])
        self._poses[sweeps[there]] = after[there]
        self._keys.place(moved)

    def _taken_along(self, moved: Moved, sweeps: IntArray, counts: IntArray) -> tuple[Array, Array]:
        """Poses of sweeps (s, 3) as drawn and where they are now, `counts` (k,) of each key pose; NaN as in `Moved`."""
        drawn, now = (np.repeat(poses, counts, axis=0) for poses in (self._keys.drawn_last(moved.rows), moved.after))
        turn, arm = now[:, 2] - drawn[:, 2], self._poses[sweeps] - drawn
        c, s = np.cos(turn), np.sin(turn)
        x, y = c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]
        before = self._poses[sweeps]
        before[np.repeat(np.isnan(moved.before[:, 0]), counts)] = math.nan
        return before, np.column_stack([now[:, 0] + x, now[:, 1] + y, now[:, 2] + arm[:, 2]])

    def _thin_out(self, beams: Beams) -> None:
        """Give up every other sweep."""
        ends = np.append(self._first, self._count)
        given_up = np.arange(1, self._count, 2)
        drawn = np.repeat(self._keys.drawn, np.diff(ends))
        before = self._poses[given_up]
        before[~drawn[given_up]] = math.nan
        self._grid.move(
            before, np.full_like(before, math.nan), Beams(beams.bearings, self._ranges[given_up], beams.max_range)
        )
        left = self._count - len(given_up)
        self._poses[:left], self._ranges[:left] = self._poses[: self._count : 2], self._ranges[: self._count : 2]
        self._first, self._count = [(first + 1) // 2 for first in self._first], left

    def _keep(self, pose: Array, beams: Beams) -> None:
        """Remember a sweep that has just been entered."""
        if self._count == MOST:
            self._thin_out(beams)
        if self._count == len(self._poses):
            room = max(64, 2 * self._count)
            poses, ranges = np.empty((room, 3)), np.empty((room, len(beams.ranges)))
            poses[: self._count] = self._poses
            ranges[: self._count] = self._ranges.reshape(-1, len(beams.ranges))
            self._poses, self._ranges = poses, ranges
        self._poses[self._count], self._ranges[self._count] = pose, beams.ranges
        self._count += 1


def _moved(pose: _Pose, motion: Array) -> _Pose:
    """A pose after a motion (3,), as `compose`."""
    (at_x, at_y, heading), (x, y, turn) = pose, motion.tolist()
    c, s = math.cos(heading), math.sin(heading)
    return at_x + c * x - s * y, at_y + s * x + c * y, heading + turn


def _apart(one: _Pose, other: _Pose, distance: float, turn: float) -> bool:
    """Two poses are more than a distance [m] or a turn [rad] apart."""
    if abs(one[0] - other[0]) + abs(one[1] - other[1]) > distance:
        return True
    return abs(math.remainder(one[2] - other[2], 2.0 * math.pi)) > turn
