"""Key poses that hang on the map: where the features move that were seen from one, it moves along.

A key pose remembers where in its frame some features lay, its anchors. Where it is now follows from where the map has
these now, by the rigid motion T that minimises Σ ‖T ⊕ p_i − F_i‖² + λ (1 − cos(θ_T − θ)): the second term, which counts
where the anchors lie close together, keeps the heading θ that it had.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._arrays import fill_from
from slam_gym._compile import compiled
from slam_gym.geometry import wrap_angle
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
        if self._count == len(self._poses):
            self._grow()
        self._drawn[self._count] = True
        _open(self._count, pose, seen, (self._poses, self._anchors, self._places), ids, positions)
        self._count += 1

    def fuse(self, pairs: IntArray) -> None:
        """Of each pair of ids (k, 2) the second is no longer in the map: its feature is the first one."""
        for kept, gone in pairs.tolist():
            anchors = self._anchors[: self._count]
            anchors[anchors == gone] = kept

    def moved(self, rows: IntArray, ids: IntArray, positions: Array, reach: float, tolerance: float) -> Moved:
        """Which of the key poses `rows` (r,) have moved by more than `tolerance` [m], their beams' middles counted in.

        A turn by α moves the middle of a beam of length `reach` [m] by α · reach / 2. Key poses that have come into the
        map, or are no longer in it, have moved. A key pose that never had an anchor stays where it is.
        """
        arrays = (self._poses, self._drawn, self._anchors, self._places)
        return Moved(*_moved(rows, arrays, ids, positions, 0.5 * reach, tolerance))

    def place(self, moved: Moved) -> None:
        """Note down that those key poses are drawn where they are now."""
        there = np.isfinite(moved.after[:, 0])
        self._drawn[moved.rows] = there
        self._poses[moved.rows[there]] = moved.after[there]

    def drawn_last(self, rows: IntArray) -> Array:
        """(k, 3) in B: where key poses are drawn, or were when they were drawn last."""
        return self._poses[rows]

    def _grow(self) -> None:
        for name in ("_poses", "_drawn", "_anchors", "_places"):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.empty_like(array)]))


@compiled
def _rows_of(ids: IntArray) -> IntArray:
    """Row of each id in the map, −1 where there is none; the last entry, which NO_ID leads to, is −1."""
    most = -1
    for feature in ids:
        most = max(most, feature)
    rows = np.full(most + 2, -1)
    for j in range(len(ids)):
        rows[ids[j]] = j
    return rows


@compiled
def _now(
    k: int, poses: Array, anchors: IntArray, places: Array, row_of: IntArray, positions: Array
) -> tuple[float, float, float]:
    """Where a key pose is now: see the module. NaN where it has lost all of its anchors."""
    x = y = u = v = 0.0
    present = 0
    for i in range(anchors.shape[1]):
        row = row_of[anchors[k, i]] if anchors[k, i] < len(row_of) - 1 else -1
        if row >= 0:
            x, y, u, v = x + places[k, i, 0], y + places[k, i, 1], u + positions[row, 0], v + positions[row, 1]
            present += 1
    if present == 0:
        return (poses[k, 0], poses[k, 1], poses[k, 2]) if anchors[k, 0] == NO_ID else (math.nan, math.nan, math.nan)
    x, y, u, v = x / present, y / present, u / present, v / present
    along, across = _STIFFNESS * math.cos(poses[k, 2]), _STIFFNESS * math.sin(poses[k, 2])
    for i in range(anchors.shape[1]):
        row = row_of[anchors[k, i]] if anchors[k, i] < len(row_of) - 1 else -1
        if row >= 0:
            px, py, fx, fy = places[k, i, 0] - x, places[k, i, 1] - y, positions[row, 0] - u, positions[row, 1] - v
            along, across = along + px * fx + py * fy, across + px * fy - py * fx
    heading = math.atan2(across, along)
    c, s = math.cos(heading), math.sin(heading)
    return u - c * x + s * y, v - s * x - c * y, heading


@compiled
def _open(
    k: int, pose: Array, seen: IntArray, arrays: tuple[Array, IntArray, Array], ids: IntArray, positions: Array
) -> None:
    """Anchor key pose k to what is seen from it, and the one before as well."""
    (poses, anchors, places), row_of, at = arrays, _rows_of(ids), (pose[0], pose[1], pose[2])
    count = 0
    fill_from(poses[k], pose)
    for i in range(anchors.shape[1]):
        anchors[k, i] = NO_ID
    for feature in seen:
        count = _anchored(k, count, at, feature, arrays, row_of, positions)
    if k == 0:
        return
    here = _now(k - 1, poses, anchors, places, row_of, positions)
    old, few, kept = anchors[k - 1].copy(), count < FEWEST_ANCHORS, 0
    for feature in old:
        if few:
            count = _anchored(k, count, at, feature, arrays, row_of, positions)
    if not math.isfinite(here[0]):
        return
    for i in range(anchors.shape[1]):
        anchors[k - 1, i] = NO_ID
    for feature in seen:
        kept = _anchored(k - 1, kept, here, feature, arrays, row_of, positions)
    for feature in old:
        kept = _anchored(k - 1, kept, here, feature, arrays, row_of, positions)


@compiled
def _anchored(
    k: int,
    count: int,
    pose: tuple[float, float, float],
    feature: int,
    arrays: tuple[Array, IntArray, Array],
    row_of: IntArray,
    at: Array,
) -> int:
    """Add an anchor to the first `count` of key pose k, which is at `pose`, if it is in the map; their number then."""
    _, anchors, places = arrays
    if count == anchors.shape[1] or feature >= len(row_of) - 1 or row_of[feature] < 0:
        return count
    for i in range(count):
        if anchors[k, i] == feature:
            return count
    c, s, row = math.cos(pose[2]), math.sin(pose[2]), row_of[feature]
    dx, dy = at[row, 0] - pose[0], at[row, 1] - pose[1]
    anchors[k, count], places[k, count, 0], places[k, count, 1] = feature, c * dx + s * dy, c * dy - s * dx
    return count + 1


@compiled
def _moved(
    rows: IntArray,
    arrays: tuple[Array, BoolArray, IntArray, Array],
    ids: IntArray,
    positions: Array,
    lever: float,
    tolerance: float,
) -> tuple[IntArray, Array, Array]:
    """`Moved`, of those rows."""
    (poses, drawn, anchors, places), row_of = arrays, _rows_of(ids)
    found, before, after = np.empty(len(rows), np.int64), np.empty((len(rows), 3)), np.empty((len(rows), 3))
    count = 0
    for k in rows:
        now = _now(k, poses, anchors, places, row_of, positions)
        there = math.isfinite(now[0])
        changed = there or drawn[k]
        if there and drawn[k]:
            turned = abs(wrap_angle(now[2] - poses[k, 2]))
            changed = math.hypot(now[0] - poses[k, 0], now[1] - poses[k, 1]) + lever * turned > tolerance
        if changed:
            found[count] = k
            after[count, 0], after[count, 1], after[count, 2] = now
            for axis in range(3):
                before[count, axis] = poses[k, axis] if drawn[k] else math.nan
            count += 1
    return found[:count], before[:count], after[:count]
