"""Keyframes: poses anchored to features of the map, so that explored space is redrawn as the estimate is corrected.

A keyframe is opened every half metre or 20°, and where the map has been corrected; it holds the sweeps taken until the
next one. It stores the positions, in its frame, of some features, its anchors. Its current pose follows from the
current estimates of these features, by the rigid motion T that minimises Σ ‖T ⊕ p_i − F_i‖² + λ (1 − cos(θ_T − θ)).
The second term, which matters where the anchors are close together, keeps its previous heading θ. When a keyframe has
moved by half a cell, its sweeps are removed from the grid and entered again at their new poses, so that no wall is
drawn twice.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import compose, wrap_angle
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.types import NO_ID, Array, Beams, BoolArray, IntArray

SPACING, TURN = 0.5, math.radians(20.0)  # [m], [rad] between keyframes
REST = 0.1  # fraction of that: within it the robot counts as at rest, and only one of its sweeps is stored
CHECK, SHARES = 10, 2  # every `CHECK` sweeps, one in `SHARES` keyframes is checked, and the last one; …
SURPRISE, SURPRISING_TURN = 0.1, math.radians(2.0)  # … so they are where a scan corrects the pose by more [m], [rad]
MOST_REDRAWN, ALLOWANCE = 3_000, 4  # most sweeps redrawn at once, and how many more for each sweep that is entered
MOST_ANCHORS = 24
FEWEST_ANCHORS = 3  # a keyframe that sees fewer also takes over those of the previous keyframe
NO_PAIRS = np.empty((0, 2), np.int64)
_STIFFNESS = 0.5  # [m²] λ/2: anchors whose squared distances from their centroid sum up to it turn a keyframe halfway

_Pose = tuple[float, float, float]  # x, y [m] and heading [rad] in B
_NOWHERE = (math.inf, 0.0, 0.0)


class _Frames(NamedTuple):
    """The arrays of all keyframes, with room for more."""

    poses: Array  # (room, 3) in B, at which they are drawn, or were drawn last
    drawn: BoolArray  # (room,)
    anchors: IntArray  # (room, MOST_ANCHORS) ids, padded with NO_ID
    places: Array  # (room, MOST_ANCHORS, 2) [m] positions of the anchors in the frame of the keyframe


_PackedFrames = tuple[Array, BoolArray, IntArray, Array]


class Keyframes:
    """Enters the sweeps of one range finder into an explored grid, and moves them as the map is corrected."""

    def __init__(self, grid: ExploredGrid) -> None:
        self._grid = grid
        room = 32
        anchors, places = np.empty((room, MOST_ANCHORS), np.int64), np.empty((room, MOST_ANCHORS, 2))
        self._frames: _PackedFrames = (np.empty((room, 3)), np.empty(room, np.bool_), anchors, places)
        self._first: list[int] = []  # index of the first sweep of each keyframe
        self._poses: list[Array] = []  # (3,) pose in B of each stored sweep, as last drawn
        self._ranges: list[Array] = []  # (b,) [m] of each stored sweep
        self._last = np.array(_NOWHERE)  # (3,) pose of the last sweep
        self._kept: Sequence[float] = _NOWHERE  # pose of the last stored sweep; no array, since every tick compares it
        self._opened: Sequence[float] = _NOWHERE  # pose of the last keyframe
        self._checks, self._unchecked, self._allowed = 0, 0, MOST_REDRAWN

    def enter(
        self, pose: Array, motion: Array, beams: Beams, seen: IntArray, m: StochasticMap, fused: IntArray = NO_PAIRS
    ) -> None:
        """Enter a sweep taken at the estimated `pose` (3,) in B, and move earlier sweeps to their current poses.

        `motion` (3,) is the motion since the last sweep by odometry; `seen` (s,) are the ids of the features of the map
        `m` seen with this sweep, and `fused` (k, 2) are the pairs of ids fused since the last sweep, the kept id first.
        Raises ValueError for a pose that is not finite, or another number of beams than before.
        """
        x, y, heading = current = pose.tolist()
        if not math.isfinite(x + y + heading):
            raise ValueError(f"pose: expected finite numbers, got {pose}")
        if self._ranges and len(beams.ranges) != len(self._ranges[0]):
            raise ValueError(f"beams: {len(beams.ranges)} of them, where sweeps so far had {len(self._ranges[0])}")
        surprised = _are_apart(current, compose(self._last, motion).tolist(), SURPRISE, SURPRISING_TURN)
        self._last, self._unchecked, corrected = pose.copy(), self._unchecked + 1, False
        self._allowed = min(self._allowed + ALLOWANCE, MOST_REDRAWN)
        if len(fused):
            anchors, seen = self._frames[2][: len(self._first)], seen.copy()
            for older, removed in fused.tolist():
                anchors[anchors == removed] = older
                seen[seen == removed] = older
        if self._first and (surprised or len(fused) or self._unchecked == CHECK):
            corrected = self._follow(beams, m.ids, m.positions)
        if corrected or _are_apart(current, self._opened, SPACING, TURN):
            self._open(pose, seen, m.ids, m.positions)
            self._opened = current
        kept = _are_apart(current, self._kept, REST * SPACING, REST * TURN)
        self._grid.integrate(pose, beams, movable=kept)
        if kept:
            self._kept = current
            self._poses.append(pose.copy())
            self._ranges.append(beams.ranges.copy())

    def _open(self, pose: Array, seen: IntArray, ids: IntArray, positions: Array) -> None:
        """Add a keyframe at `pose` (3,), anchored to the features with ids `seen` (s,)."""
        count = len(self._first)
        if count == len(self._frames[0]):
            poses, drawn, anchors, places = (np.concatenate([a, np.empty_like(a)]) for a in self._frames)
            self._frames = (poses, drawn, anchors, places)
        _open(self._frames, count, pose, seen, _rows_of(ids), positions)
        self._first.append(len(self._poses))

    def _follow(self, beams: Beams, ids: IntArray, positions: Array) -> bool:
        """Redraw the keyframes that have moved, among a share of all; if the last one has moved, among all of them.

        Returns whether the last one has moved, because the next sweeps then need a new keyframe.
        """
        last, share = len(self._first) - 1, self._checks % SHARES
        self._checks, self._unchecked = self._checks + 1, 0
        lever, tolerance = 0.5 * beams.max_range, 0.5 * self._grid.resolution
        rows = np.arange(share, last + SHARES, SHARES)
        rows[-1] = last
        row_of = _rows_of(ids)
        moved, now = _moved(self._frames, rows, row_of, positions, lever, tolerance)
        corrected = len(moved) > 0 and bool(moved[-1] == last)
        if corrected:
            moved, now = _moved(self._frames, np.arange(last + 1), row_of, positions, lever, tolerance)
        if len(moved):
            self._redraw(moved, now, beams)
        return corrected

    def _redraw(self, moved: IntArray, now: Array, beams: Beams) -> None:
        """Remove the sweeps of the keyframes `moved` (k,) from the grid, and enter them again at `now` (k, 3).

        The number of sweeps is limited, so that a map that moves all the time does not stop the robot: the latest
        keyframes come first, the others when they are checked next.
        """
        ends = np.append(self._first, len(self._poses))
        counts = ends[moved + 1] - ends[moved]
        first = int(np.searchsorted(-np.cumsum(counts[::-1])[::-1], -self._allowed))
        moved, now, counts = moved[first:], now[first:], counts[first:]
        self._allowed -= int(counts.sum())
        if not len(counts):
            return
        poses, drawn, _, _ = self._frames
        sweeps = [sweep for k in moved.tolist() for sweep in range(ends[k], ends[k + 1])]
        if sweeps:
            before = np.array([self._poses[sweep] for sweep in sweeps])
            after = _moved_with_keyframes(before, poses[moved], now, counts)
            for sweep, pose in zip(sweeps, after):
                if math.isfinite(pose[0]):
                    self._poses[sweep] = pose
            before[np.repeat(~drawn[moved], counts)] = math.nan
            ranges = np.array([self._ranges[sweep] for sweep in sweeps])
            self._grid.move(before, after, Beams(beams.bearings, ranges, beams.max_range))
        in_map = np.isfinite(now[:, 0])
        drawn[moved] = in_map
        poses[moved[in_map]] = now[in_map]


def _moved_with_keyframes(sweeps: Array, drawn: Array, now: Array, counts: IntArray) -> Array:
    """Poses (s, 3) of sweeps after their keyframes, of `counts` (k,) sweeps each, have moved from `drawn` to `now`."""
    drawn, now = np.repeat(drawn, counts, axis=0), np.repeat(now, counts, axis=0)
    turn, arm = now[:, 2] - drawn[:, 2], sweeps - drawn
    c, s = np.cos(turn), np.sin(turn)
    x, y = c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]
    return np.column_stack([now[:, 0] + x, now[:, 1] + y, now[:, 2] + arm[:, 2]])


def _are_apart(one: Sequence[float], other: Sequence[float], distance: float, turn: float) -> bool:
    """Whether two poses are more than a distance [m] or a turn [rad] apart."""
    if abs(one[0] - other[0]) + abs(one[1] - other[1]) > distance:
        return True
    return abs(math.remainder(one[2] - other[2], 2.0 * math.pi)) > turn


def _rows_of(ids: IntArray) -> IntArray:
    """Row in the map of each id, −1 for ids not in it; the last entry, for NO_ID and all higher ids, is −1."""
    rows = np.full(ids.max(initial=-1) + 2, -1)
    rows[ids] = np.arange(len(ids))
    return rows


@compiled
def _pose_now(frames: _Frames, k: int, row_of: IntArray, positions: Array) -> _Pose:
    """The current pose of keyframe k (see the module's docstring); NaN if none of its anchors is in the map."""
    poses, anchors, places = frames.poses, frames.anchors, frames.places
    x = y = u = v = 0.0
    present = 0
    for i in range(anchors.shape[1]):
        row = row_of[min(anchors[k, i], len(row_of) - 1)]
        if row >= 0:
            x, y, u, v = x + places[k, i, 0], y + places[k, i, 1], u + positions[row, 0], v + positions[row, 1]
            present += 1
    if present == 0:
        return (poses[k, 0], poses[k, 1], poses[k, 2]) if anchors[k, 0] == NO_ID else (math.nan, math.nan, math.nan)
    x, y, u, v = x / present, y / present, u / present, v / present
    along, across = _STIFFNESS * math.cos(poses[k, 2]), _STIFFNESS * math.sin(poses[k, 2])
    for i in range(anchors.shape[1]):
        row = row_of[min(anchors[k, i], len(row_of) - 1)]
        if row >= 0:
            px, py, fx, fy = places[k, i, 0] - x, places[k, i, 1] - y, positions[row, 0] - u, positions[row, 1] - v
            along, across = along + px * fx + py * fy, across + px * fy - py * fx
    heading = math.atan2(across, along)
    c, s = math.cos(heading), math.sin(heading)
    return u - c * x + s * y, v - s * x - c * y, heading


@compiled
def _open(packed: _PackedFrames, k: int, pose: Array, seen: IntArray, row_of: IntArray, positions: Array) -> None:
    """Anchor keyframe k to the features `seen`, and the previous keyframe, which ends here, to them as well."""
    frames = _Frames(*packed)
    here, count = (pose[0], pose[1], pose[2]), 0
    frames.drawn[k] = True
    frames.poses[k, :] = pose
    frames.anchors[k, :] = NO_ID
    for feature in seen:
        count = _anchored(frames, k, count, here, feature, row_of, positions)
    if k == 0:
        return
    before = _pose_now(frames, k - 1, row_of, positions)
    old, few, kept = frames.anchors[k - 1].copy(), count < FEWEST_ANCHORS, 0
    for feature in old:
        if few:
            count = _anchored(frames, k, count, here, feature, row_of, positions)
    if not math.isfinite(before[0]):
        return
    frames.anchors[k - 1, :] = NO_ID
    for feature in seen:
        kept = _anchored(frames, k - 1, kept, before, feature, row_of, positions)
    for feature in old:
        kept = _anchored(frames, k - 1, kept, before, feature, row_of, positions)


@compiled
def _anchored(
    frames: _Frames, k: int, count: int, pose: _Pose, feature: int, row_of: IntArray, positions: Array
) -> int:
    """Add `feature`, if it is in the map, to the `count` anchors of keyframe k at `pose`; returns their new number."""
    anchors, row = frames.anchors, row_of[min(feature, len(row_of) - 1)]
    if count == anchors.shape[1] or row < 0:
        return count
    for i in range(count):
        if anchors[k, i] == feature:
            return count
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = positions[row, 0] - pose[0], positions[row, 1] - pose[1]
    anchors[k, count] = feature
    frames.places[k, count, 0], frames.places[k, count, 1] = c * dx + s * dy, c * dy - s * dx
    return count + 1


@compiled
def _moved(
    packed: _PackedFrames, rows: IntArray, row_of: IntArray, positions: Array, lever: float, tolerance: float
) -> tuple[IntArray, Array]:
    """The keyframes (k,) among `rows` (r,) that have moved by more than `tolerance` [m], and their poses now (k, 3).

    A turn counts by the arc at `lever` [m], half the range of a beam. A keyframe whose anchors have all left the map
    counts as moved, to a pose of NaN, and so does one whose anchors have come back. A keyframe that never had an anchor
    does not move.
    """
    frames = _Frames(*packed)
    moved, after, count = np.empty(len(rows), np.int64), np.empty((len(rows), 3)), 0
    for k in rows:
        now, pose = _pose_now(frames, k, row_of, positions), frames.poses[k]
        in_map, drawn = math.isfinite(now[0]), frames.drawn[k]
        changed = in_map or drawn
        if in_map and drawn:
            turned = abs(wrap_angle(now[2] - pose[2]))
            changed = math.hypot(now[0] - pose[0], now[1] - pose[1]) + lever * turned > tolerance
        if changed:
            moved[count] = k
            after[count, 0], after[count, 1], after[count, 2] = now
            count += 1
    return moved[:count], after[:count]
