"""Path following: nearest point of a path, remaining length, and pure pursuit for a differential-drive robot."""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.types import Array

LOOKAHEAD = 0.4  # [m]
TURN_GAIN = 4.0  # [1/s] turning speed per heading error
STOP_ANGLE = 0.7  # [rad] heading error above which the robot turns on the spot
DECELERATION = 1.5  # [m/s²] at the end of the path
TOLERANCE = 0.03  # [m] distance from the end at which the robot stops


@compiled
def on_path(path: Array, position: Array) -> tuple[int, float, float]:
    """The point of a path (p, 2), p ≥ 2, that is nearest to `position` (2,).

    Returns the index of its segment, and the distances [m] from the beginning of the segment to the point, and from the
    point to the position.
    """
    best, segment, covered = math.inf, 0, 0.0
    x, y = position[0], position[1]
    for i in range(path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        squared = dx * dx + dy * dy
        t = 0.0 if squared == 0.0 else min(1.0, max(0.0, ((x - path[i, 0]) * dx + (y - path[i, 1]) * dy) / squared))
        gap = math.hypot(path[i, 0] + t * dx - x, path[i, 1] + t * dy - y)
        if gap < best:
            best, segment, covered = gap, i, t * math.sqrt(squared)
    return segment, covered, best


@compiled
def length_left(path: Array, position: Array) -> float:
    """[m] from `position` (2,) to the nearest point of the path (p, 2), p ≥ 2, and along the path from there."""
    (segment, covered, gap), remaining = on_path(path, position), 0.0
    for i in range(segment, path.shape[0] - 1):
        remaining += math.hypot(path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1])
    return gap + remaining - covered


def next_stretch(path: Array, position: Array, ahead: float) -> tuple[Array, Array]:
    """The next `ahead` metres of a path (p, 2), p ≥ 2, from the segment nearest to `position`.

    Returns the waypoints (q, 2) of this part, and the waypoints (r, 2) after it.
    """
    (segment, covered, _), total = on_path(path, position), 0.0
    for i in range(segment, path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        length = math.hypot(dx, dy)
        total += length
        if total - covered >= ahead:
            stretch, back = path[segment : i + 2].copy(), (total - covered - ahead) / max(length, 1e-9)
            stretch[-1, 0], stretch[-1, 1] = path[i + 1, 0] - back * dx, path[i + 1, 1] - back * dy
            return stretch, path[i + 1 :].copy()
    return path[segment:].copy(), path[:0].copy()


def points_ahead(path: Array, position: Array, spacing: float) -> Array:
    """Points (q, 2) about `spacing` [m] apart along the path (p, 2), p ≥ 1, from the waypoint nearest to `position` on.

    If the last waypoint is the nearest, it is the only point.
    """
    remaining = path[np.square(path - position).sum(axis=1).argmin() :]
    if len(remaining) == 1:
        return remaining.copy()
    starts = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(remaining, axis=0).T))])  # [m] of the waypoints
    at = spacing * np.arange(math.ceil(starts[-1] / spacing))
    return np.column_stack([np.interp(at, starts, remaining[:, 0]), np.interp(at, starts, remaining[:, 1])])


@compiled
def follow(pose: Array, path: Array, max_speed: float, max_turn: float) -> tuple[float, float]:
    """Forward and turning speed for a robot at `pose` (3,) to follow `path` (p, 2), both in B.

    The speeds are fractions in [−1, 1] of `max_speed` [m/s] and `max_turn` [rad/s]; for an empty path they are 0.

    Pure pursuit (Coulter, 1992) of the point `LOOKAHEAD` beyond the one nearest to the robot. The robot drives slower
    the larger its heading error and, near the end of the path, the less distance remains to stop. It first corrects a
    large error on the spot.
    """
    if path.shape[0] == 0:
        return 0.0, 0.0
    segment, covered, _ = on_path(path, pose[:2])
    x, y, remaining, passed = path[-1, 0], path[-1, 1], -covered, False
    for i in range(segment, path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        length = math.hypot(dx, dy)
        if not passed and remaining + length >= LOOKAHEAD:
            t = (LOOKAHEAD - remaining) / length if length > 0.0 else 0.0
            x, y, passed = path[i, 0] + t * dx, path[i, 1] + t * dy, True
        remaining += length
    remaining = max(remaining, math.hypot(path[-1, 0] - pose[0], path[-1, 1] - pose[1]))
    if remaining < TOLERANCE:
        return 0.0, 0.0
    error = wrap_angle(math.atan2(y - pose[1], x - pose[0]) - pose[2])
    slowdown = max(0.0, 1.0 - abs(error) / STOP_ANGLE)
    speed = min(max_speed, math.sqrt(2.0 * DECELERATION * remaining)) * slowdown
    turn = min(max_turn, max(-max_turn, TURN_GAIN * error))
    return speed / max_speed, turn / max_turn
