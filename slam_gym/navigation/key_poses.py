"""Key poses that hang on the map: where the features move that were seen from one, it moves along.

A key pose remembers where in its frame some features lay, its anchors. Where it is now follows from where the map has
these now, by the rigid motion T that minimises Σ ‖T ⊕ p_i − F_i‖² + λ (1 − cos(θ_T − θ)): the second term, which counts
where the anchors lie close together, keeps the heading θ that it had.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.geometry import observe, wrap_angle
from slam_gym.types import NO_ID, Array, BoolArray, IntArray

MOST_ANCHORS = 24
FEWEST_ANCHORS = 3  # a key pose that sees fewer takes over those of the one before
_STIFFNESS = 0.5  # [m²] λ/2: anchors whose squared distances from their middle sum up to it turn a key pose halfway
_ROOM = 32


class Moved(NamedTuple):
    """Key poses that are no longer where they are drawn."""

    rows: IntArray  # (k,)
    before: Array  # (k, 3) in B, where they are drawn; NaN: they are not
    after: Array  # (k, 3) in B, where they are now; NaN: none of their anchors is in the map


class KeyPoses:
    """Poses with their anchors; features are known by ids that are never given twice.

    Whatever takes `ids` (n,) and `positions` (n, 2) [m] in B takes all features that are in the map now.
    """

    def __init__(self) -> None:
        self._count = 0
        self._poses = np.empty((_ROOM, 3))  # in B, where they are drawn, or were drawn last
        self._drawn = np.empty(_ROOM, np.bool_)
        self._anchors = np.empty((_ROOM, MOST_ANCHORS), np.int64)  # ids, then NO_ID
        self._places = np.empty((_ROOM, MOST_ANCHORS, 2))  # [m] in the frame of the key pose

    def __len__(self) -> int:
        return self._count

    @property
    def drawn(self) -> BoolArray:
        """(k,) which of them are drawn."""
        return self._drawn[: self._count].copy()

    def open(self, pose: Array, seen: IntArray, ids: IntArray, positions: Array) -> None:
        """Add a key pose at `pose` (3,), where the features with ids `seen` (s,) were seen; NO_ID counts for nothing.

        The one before is closed with that: what is seen from its end anchors it as well.
        """
        last, borrowed = self._count - 1, np.empty(0, np.int64)
        seen = np.intersect1d(seen, ids)
        if last >= 0:
            here = _now(last, self._poses, self._anchors, self._places, _rows_of(ids), positions)
            borrowed = np.intersect1d(self._anchors[last], ids)
            if math.isfinite(here[0]):
                self._anchor(last, here, np.union1d(borrowed, seen), ids, positions)
        if self._count == len(self._poses):
            self._grow()
        self._poses[self._count], self._drawn[self._count] = pose, True
        enough = len(seen) >= FEWEST_ANCHORS
        self._anchor(self._count, pose, seen if enough else np.union1d(seen, borrowed), ids, positions)
        self._count += 1

    def moved(self, rows: IntArray, ids: IntArray, positions: Array, reach: float, tolerance: float) -> Moved:
        """Which of the key poses `rows` (r,) have moved by more than `tolerance` [m], their beams' middles counted in.

        A turn by α moves the middle of a beam of length `reach` [m] by α · reach / 2. Key poses that have come into the
        map, or are no longer in it, have moved. A key pose that never had an anchor stays where it is.
        """
        arrays = (self._poses, self._drawn, self._anchors, self._places)
        found, after = _moved(rows, arrays, _rows_of(ids), positions, 0.5 * reach, tolerance)
        before = self._poses[found]
        before[~self._drawn[found]] = math.nan
        return Moved(found, before, after)

    def place(self, moved: Moved) -> None:
        """Note down that those key poses are drawn where they are now."""
        there = np.isfinite(moved.after[:, 0])
        self._drawn[moved.rows] = there
        self._poses[moved.rows[there]] = moved.after[there]

    def drawn_last(self, rows: IntArray) -> Array:
        """(k, 3) in B: where key poses are drawn, or were when they were drawn last."""
        return self._poses[rows]

    def _anchor(self, row: int, pose: Array, anchors: IntArray, ids: IntArray, positions: Array) -> None:
        """Anchor a key pose that is at `pose` to features that are in the map."""
        anchors = anchors[-MOST_ANCHORS:]  # the youngest, which were seen from nearest by
        count, order = len(anchors), np.argsort(ids)
        at = order[np.searchsorted(ids, anchors, sorter=order)]
        self._anchors[row], self._anchors[row, :count] = NO_ID, anchors
        self._places[row, :count] = observe(pose, positions[at])

    def _grow(self) -> None:
        for name in ("_poses", "_drawn", "_anchors", "_places"):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.empty_like(array)]))


@compiled
def _rows_of(ids: IntArray) -> IntArray:
    """Row of each id in the map, −1 where there is none; the last entry, which NO_ID leads to, is −1."""
    rows = np.full(ids.max() + 2 if len(ids) else 1, -1)
    for j in range(len(ids)):
        rows[ids[j]] = j
    return rows


@compiled
def _now(k: int, poses: Array, anchors: IntArray, places: Array, row_of: IntArray, positions: Array) -> Array:
    """Where a key pose is now (3,): see the module. NaN where it has lost all of its anchors."""
    x = y = u = v = 0.0
    present = 0
    for i in range(anchors.shape[1]):
        row = row_of[anchors[k, i]] if anchors[k, i] < len(row_of) - 1 else -1
        if row >= 0:
            x, y, u, v = x + places[k, i, 0], y + places[k, i, 1], u + positions[row, 0], v + positions[row, 1]
            present += 1
    out: Array = poses[k].copy()
    if present == 0:
        if anchors[k, 0] != NO_ID:
            out[:] = math.nan
        return out
    x, y, u, v = x / present, y / present, u / present, v / present
    along, across = _STIFFNESS * math.cos(out[2]), _STIFFNESS * math.sin(out[2])
    for i in range(anchors.shape[1]):
        row = row_of[anchors[k, i]] if anchors[k, i] < len(row_of) - 1 else -1
        if row >= 0:
            px, py, fx, fy = places[k, i, 0] - x, places[k, i, 1] - y, positions[row, 0] - u, positions[row, 1] - v
            along, across = along + px * fx + py * fy, across + px * fy - py * fx
    out[2] = math.atan2(across, along)
    c, s = math.cos(out[2]), math.sin(out[2])
    out[0], out[1] = u - c * x + s * y, v - s * x - c * y
    return out


@compiled
def _moved(
    rows: IntArray,
    arrays: tuple[Array, BoolArray, IntArray, Array],
    row_of: IntArray,
    positions: Array,
    lever: float,
    tolerance: float,
) -> tuple[IntArray, Array]:
    """Those of the rows that have moved, and where they are now."""
    poses, drawn, anchors, places = arrays
    found, after, count = np.empty(len(rows), np.int64), np.empty((len(rows), 3)), 0
    for k in rows:
        now = _now(k, poses, anchors, places, row_of, positions)
        there = math.isfinite(now[0])
        if there and drawn[k]:
            turned = abs(wrap_angle(now[2] - poses[k, 2]))
            there = math.hypot(now[0] - poses[k, 0], now[1] - poses[k, 1]) + lever * turned > tolerance
            found[count], after[count] = k, now
            count += there
        elif there or drawn[k]:
            found[count], after[count] = k, now
            count += 1
    return found[:count], after[:count]
