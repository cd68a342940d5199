"""The reference corridor: a robot drives once round a square corridor and returns with a drifted heading.

A re-creation of the simulator of Neira and Tardós' teaching material, without walls that hide features. Its figures
depend on these details: the square has sides of 10 m; each side carries 22 point features; the robot makes 44 steps of
1 m from (0, 0) along +x, turning left by 90° at the end of steps 10, 20, 30 and 40, so that the last four repeat the
first side. It scans at step 0 and after every step. All features in range and field of view are measured, without
clutter.
"""

import math
from collections.abc import Iterator

import numpy as np

from slam_gym.geometry import compose, observe
from slam_gym.types import Array, Odometry, Scan, Truth

SIDE = 10.0  # [m]
STEPS = 44
RANGE = 5.0  # [m]
RANGE_SIGMA = 0.01  # [m/m] of the range
BEARING_SIGMA = math.radians(0.125)
STRAIGHT_SIGMA = (0.01, 0.01, math.radians(2.0))  # [m, m, rad] per step
TURN_SIGMA = (0.03, 0.03, math.radians(2.5))


def features() -> Array:
    """The 88 point features of the corridor, (88, 2) [m]."""
    even, odd = np.arange(0.0, 11.0, 2.0), np.arange(1.0, 10.0, 2.0)
    walls = ((-0.6, even), (-0.35, even), (0.35, odd), (0.6, odd))
    side = np.concatenate([np.column_stack([x, np.full(len(x), y)]) for y, x in walls])
    corners = np.array([[0.0, 0.0, 0.0], [SIDE, 0.0, 90.0], [SIDE, SIDE, 180.0], [0.0, SIDE, 270.0]])
    turned = []
    for x, y, degrees in corners:
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        turned.append(side @ np.array([[c, s], [-s, c]]) + (x, y))
    return np.concatenate(turned)


def walk_round(rng: np.random.Generator, q: float = 1.0) -> Iterator[tuple[Odometry, Scan, Truth]]:
    """The 45 scans of one loop, each with the motion before it; `q` scales the reported covariance of the motion."""
    world, pose = features(), np.zeros(3)
    for step in range(STEPS + 1):
        pose, odometry = _move(step, pose, q, rng)
        yield odometry, *_scan(world, pose, rng)


def _move(step: int, pose: Array, q: float, rng: np.random.Generator) -> tuple[Array, Odometry]:
    """The true pose after `step`, and the odometry of that step. At step 0 the robot rests, without uncertainty."""
    if step == 0:
        return pose, Odometry(np.zeros(3), np.zeros((3, 3)))
    turning = step % int(SIDE) == 0
    sigma = np.array(TURN_SIGMA if turning else STRAIGHT_SIGMA)
    intended = np.array([1.0, 0.0, math.pi / 2 if turning else 0.0])
    measured = intended + sigma * rng.standard_normal(3)
    return compose(pose, intended), Odometry(measured, q * np.diag(sigma**2))


def _scan(world: Array, pose: Array, rng: np.random.Generator) -> tuple[Scan, Truth]:
    """A scan of the features within 5 m and ±90°: noisy ranges and bearings, in Cartesian form."""
    x, y = np.ascontiguousarray(observe(pose, world).T)
    ranges, bearings = np.hypot(x, y), np.arctan2(y, x)
    seen = np.flatnonzero((ranges <= RANGE) & (x >= 0.0))
    seen = seen[np.argsort(bearings[seen])]
    measured = ranges[seen] + RANGE_SIGMA * ranges[seen] * rng.standard_normal(len(seen))
    angles = bearings[seen] + BEARING_SIGMA * rng.standard_normal(len(seen))
    return Scan.from_polar(measured, angles, RANGE_SIGMA * measured, BEARING_SIGMA), Truth(pose, seen)
