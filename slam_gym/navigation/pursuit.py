"""Following a path: where on it the robot is, what is left of it, and pure pursuit for a differential-drive robot."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.types import Array


class OnPath(NamedTuple):
    """The point of a path that is nearest to some position."""

    segment: int  # that it lies on
    covered: float  # [m] from the beginning of the segment
    gap: float  # [m] to the position


@compiled
def on_path(path: Array, position: Array) -> OnPath:
    """Where a path (p, 2), p ≥ 2, is nearest to `position` (2,)."""
    best, segment, covered = math.inf, 0, 0.0
    x, y = position[0], position[1]
    for i in range(path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        squared = dx * dx + dy * dy
        t = 0.0 if squared == 0.0 else min(1.0, max(0.0, ((x - path[i, 0]) * dx + (y - path[i, 1]) * dy) / squared))
        gap = math.hypot(path[i, 0] + t * dx - x, path[i, 1] + t * dy - y)
        if gap < best:
            best, segment, covered = gap, i, t * math.sqrt(squared)
    return OnPath(segment, covered, best)


@compiled
def length_left(path: Array, position: Array) -> float:
    """[m] to the point of the path (p, 2), p ≥ 2, that is nearest to `position` (2,), and along it from there."""
    at, left = on_path(path, position), 0.0
    for i in range(at.segment, path.shape[0] - 1):
        left += math.hypot(path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1])
    return at.gap + left - at.covered


def next_stretch(path: Array, position: Array, ahead: float) -> tuple[Array, Array]:
    """The next `ahead` metres of a path (p, 2), p ≥ 2, from the segment nearest to `position`; the waypoints then."""
    at, total = on_path(path, position), 0.0
    for i in range(at.segment, path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        length = math.hypot(dx, dy)
        total += length
        if total - at.covered >= ahead:
            stretch, back = path[at.segment : i + 2].copy(), (total - at.covered - ahead) / max(length, 1e-9)
            stretch[-1, 0], stretch[-1, 1] = path[i + 1, 0] - back * dx, path[i + 1, 1] - back * dy
            return stretch, path[i + 1 :].copy()
    return path[at.segment :].copy(), path[:0].copy()


def points_ahead(path: Array, position: Array, spacing: float) -> Array:
    """Points (q, 2) along the path (p, 2), p ≥ 1, from the waypoint nearest to `position` on, some `spacing` [m] apart.

    The last waypoint alone is itself.
    """
    left = path[np.square(path - position).sum(axis=1).argmin() :]
    if len(left) == 1:
        return left.copy()
    starts = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(left, axis=0).T))])  # [m] of the waypoints
    at = spacing * np.arange(math.ceil(starts[-1] / spacing))
    return np.column_stack([np.interp(at, starts, left[:, 0]), np.interp(at, starts, left[:, 1])])


class PursuitSpec(NamedTuple):
    """A differential-drive robot and how it chases a point ahead of it on its path."""

    max_speed: float = 1.0  # [m/s] of the fraction 1
    max_turn: float = 2.0  # [rad/s] of the fraction 1
    lookahead: float = 0.4  # [m]
    turn_gain: float = 4.0  # [1/s] turning speed per heading error
    stop_angle: float = 0.7  # [rad] heading error from which on the robot turns on the spot
    deceleration: float = 1.5  # [m/s²] with which it comes to rest at the end of the path
    tolerance: float = 0.03  # [m] from the end at which it rests


class Twist(NamedTuple):
    """Speeds as fractions in [−1, 1] of the greatest."""

    forward: float
    turn: float


_STANDARD = PursuitSpec()


def follow(pose: Array, path: Array, spec: PursuitSpec = _STANDARD) -> Twist:
    """The speeds for a robot at `pose` (3,) to follow `path` (p, 2), both in B.

    Pure pursuit (Coulter, 1992) of the point `lookahead` beyond the one nearest to the robot, slower the larger the
    heading error and, near the end of the path, the less room there is to stop. Large errors are turned away on the
    spot first. An empty path means standing still.
    """
    return Twist(*_pursue(pose, path, tuple(spec)))


@compiled
def _pursue(pose: Array, path: Array, packed: tuple[float, ...]) -> tuple[float, float]:
    """Forward and turning speed, as fractions, towards the point `lookahead` beyond the nearest one of the path."""
    if path.shape[0] == 0:
        return 0.0, 0.0
    spec, at = PursuitSpec(*packed), on_path(path, pose[:2])
    x, y, left, passed = path[-1, 0], path[-1, 1], -at.covered, False
    for i in range(at.segment, path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        length = math.hypot(dx, dy)
        if not passed and left + length >= spec.lookahead:
            t = (spec.lookahead - left) / length if length > 0.0 else 0.0
            x, y, passed = path[i, 0] + t * dx, path[i, 1] + t * dy, True
        left += length
    left = max(left, math.hypot(path[-1, 0] - pose[0], path[-1, 1] - pose[1]))
    if left < spec.tolerance:
        return 0.0, 0.0
    error = wrap_angle(math.atan2(y - pose[1], x - pose[0]) - pose[2])
    slower = max(0.0, 1.0 - abs(error) / spec.stop_angle)
    speed = min(spec.max_speed, math.sqrt(2.0 * spec.deceleration * left)) * slower
    turn = min(spec.max_turn, max(-spec.max_turn, spec.turn_gain * error))
    return speed / spec.max_speed, turn / spec.max_turn
