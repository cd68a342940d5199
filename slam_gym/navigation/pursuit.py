"""Driving along a path: pure pursuit for a differential-drive robot."""

from __future__ import annotations

import math
from dataclasses import dataclass

from slam_gym._compile import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.types import Array


@dataclass(frozen=True, slots=True)
class PursuitSpec:
    """A differential-drive robot and how it chases a point ahead of it on its path."""

    max_speed: float = 1.0  # [m/s] of the fraction 1
    max_turn: float = 2.0  # [rad/s] of the fraction 1
    lookahead: float = 0.4  # [m]
    turn_gain: float = 4.0  # [1/s] turning speed per heading error
    stop_angle: float = 0.7  # [rad] heading error from which on the robot turns on the spot
    deceleration: float = 1.5  # [m/s²] with which it comes to rest at the end of the path
    tolerance: float = 0.03  # [m] from the end at which it rests


def follow(pose: Array, path: Array, spec: PursuitSpec = PursuitSpec()) -> tuple[float, float]:
    """Forward and turning speed, fractions in [−1, 1], for a robot at `pose` (3,) to follow `path` (p, 2), both in B.

    Pure pursuit (Coulter, 1992) of the point `lookahead` beyond the one nearest to the robot, slower the larger the
    heading error and, near the end of the path, the less room there is to stop. Large errors are turned away on the
    spot first. An empty path means standing still.
    """
    return _pursue(pose, path, spec.max_speed, spec.max_turn, spec.lookahead, spec.turn_gain, spec.stop_angle,
                   spec.deceleration, spec.tolerance)  # fmt: skip


@compiled
def _ahead(x: float, y: float, path: Array, lookahead: float) -> tuple[float, float, float]:
    """The point of a polyline `lookahead` beyond the one nearest to (x, y), and the length left from the nearest on."""
    best, segment, along = math.inf, 0, 0.0
    for i in range(path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        squared = dx * dx + dy * dy
        t = 0.0 if squared == 0.0 else min(1.0, max(0.0, ((x - path[i, 0]) * dx + (y - path[i, 1]) * dy) / squared))
        distance = math.hypot(path[i, 0] + t * dx - x, path[i, 1] + t * dy - y)
        if distance < best:
            best, segment, along = distance, i, t * math.sqrt(squared)
    target_x, target_y = path[-1, 0], path[-1, 1]
    left, found = -along, False
    for i in range(segment, path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        length = math.hypot(dx, dy)
        if not found and left + length >= lookahead:
            t = (lookahead - left) / length if length > 0.0 else 0.0
            target_x, target_y, found = path[i, 0] + t * dx, path[i, 1] + t * dy, True
        left += length
    return target_x, target_y, left


@compiled
def _pursue(
    pose: Array, path: Array, max_speed: float, max_turn: float, lookahead: float, turn_gain: float, stop_angle: float,
    deceleration: float, tolerance: float,
) -> tuple[float, float]:  # fmt: skip
    if path.shape[0] == 0:
        return 0.0, 0.0
    x, y, left = _ahead(pose[0], pose[1], path, lookahead)
    left = max(left, math.hypot(path[-1, 0] - pose[0], path[-1, 1] - pose[1]))
    if left < tolerance:
        return 0.0, 0.0
    error = wrap_angle(math.atan2(y - pose[1], x - pose[0]) - pose[2])
    speed = min(max_speed, math.sqrt(2.0 * deceleration * left)) * max(0.0, 1.0 - abs(error) / stop_angle)
    turn = min(max_turn, max(-max_turn, turn_gain * error))
    return speed / max_speed, turn / max_turn
