"""The inner loop of a drive in outline: along a path, a stretch at a time, and what is in sight at the end of each."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.geometry import compose, wrap_angle
from slam_gym.types import Array, IntArray
from slam_gym.world.ray_casting import cast, sees
from slam_gym.world.wall_grid import Grid, Packed

STRETCH, SPEED = 4, 0.095  # [ticks] between looks, and [m/tick] along a path
TURN, FREE_TURN = 4.0, 0.3  # [ticks/rad] for what a path turns by at once, but for so much [rad]


class Surroundings(NamedTuple):
    """What there is to see, and how far the robot's senses reach."""

    walls: Packed  # furniture among them
    features: Array  # (N, 2) [m] in W
    pull_backs: Array  # (N,) [m]
    base: Array  # (3,) of B in W
    near: float  # [m] of the nearest feature that is seen
    far: float  # [m] of the farthest
    half_view: float  # [rad] to either side of the heading
    bearings: Array  # (b,) [rad] of the beams
    reach: float  # [m] of the beams


class Stretches(NamedTuple):
    """k stretches that have been driven."""

    poses: Array  # (k, 3) in B, at the end of each
    ranges: Array  # (k, b) [m] of the beams there
    ticks: int  # that they took
    passed: int  # waypoints of the path that lie behind


@compiled
def look(around: Surroundings, here: Array, sighted: IntArray) -> Array:
    """Ranges (b,) of the beams from `here` (3,) in B; features in sight are counted in `sighted` (N,)."""
    pose, grid = compose(around.base, here), Grid(*around.walls)
    for i in range(len(around.features)):
        dx, dy = around.features[i, 0] - pose[0], around.features[i, 1] - pose[1]
        if not around.near <= math.hypot(dx, dy) <= around.far:
            continue
        if abs(wrap_angle(math.atan2(dy, dx) - pose[2])) > around.half_view:
            continue
        if sees(grid, pose[0], pose[1], dx, dy, around.pull_backs[i]):
            sighted[i] += 1
    nothing = (np.empty((0, 3)), np.empty((0, 4)))
    return cast(around.walls, pose[:2], pose[2] + around.bearings, around.reach, nothing)


@compiled
def drive_along(
    around: Surroundings, here: Array, path: Array, count: int, arrived: float, ticks: int, sighted: IntArray
) -> Stretches:
    """At most `count` stretches along a path (p, 2) from `here` (3,), its first point, none begun after `ticks` ticks.

    Ends within `arrived` [m] of the end of the path. What comes in sight is counted in `sighted` (N,).
    """
    poses, ranges = np.empty((count, 3)), np.empty((count, len(around.bearings)))
    (x, y, heading), k, used, at, goal = here, 0, 0, 1, path[-1]
    while k < count and used < ticks and at < len(path) and math.hypot(goal[0] - x, goal[1] - y) >= arrived:
        left, turned = STRETCH * SPEED, 0.0
        while left > 1e-9 and at < len(path):
            dx, dy = path[at, 0] - x, path[at, 1] - y
            length = math.hypot(dx, dy)
            if length > 1e-6:
                before, heading = heading, math.atan2(dy, dx)
                turned += max(0.0, abs(wrap_angle(heading - before)) - FREE_TURN)
                part = min(1.0, left / length)
                x, y, left = x + part * dx, y + part * dy, left - part * length
            if left > 1e-9:
                at += 1
        used += STRETCH + round(TURN * turned)
        poses[k] = x, y, heading
        ranges[k] = look(around, poses[k], sighted)
        k += 1
    return Stretches(poses[:k], ranges[:k], used, at)
