"""A path as a line of waypoints: the point of it that is nearest, what is left of it from there, points along it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.types import Array


class OnPath(NamedTuple):
    """The point of a path that is nearest to some position."""

    segment: int  # that it lies on
    covered: float  # [m] from the beginning of the segment
    gap: float  # [m] to the position


@compiled
def on_path(path: Array, position: Array) -> OnPath:
    """Where a path (p, 2), p ≥ 2, is nearest to `position` (2,)."""
    best = OnPath(0, 0.0, math.inf)
    for i in range(path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        length = math.hypot(dx, dy)
        x, y = position[0] - path[i, 0], position[1] - path[i, 1]
        along = min(1.0, max(0.0, (x * dx + y * dy) / max(length, 1e-9) ** 2))
        gap = math.hypot(x - along * dx, y - along * dy)
        if gap < best.gap:
            best = OnPath(i, along * length, gap)
    return best


@compiled
def length_left(path: Array, position: Array) -> float:
    """[m] to the point of the path (p, 2), p ≥ 2, that is nearest to `position` (2,), and along it from there."""
    at, left = on_path(path, position), 0.0
    for i in range(at.segment, path.shape[0] - 1):
        left += math.hypot(path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1])
    return at.gap + left - at.covered


@compiled
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


@compiled
def points_ahead(path: Array, position: Array, spacing: float) -> Array:
    """Points (q, 2) along the path (p, 2), p ≥ 1, from the waypoint nearest to `position` on, some `spacing` [m] apart.

    The last waypoint alone is itself.
    """
    first, least = 0, math.inf
    for i in range(path.shape[0]):
        squared = (path[i, 0] - position[0]) ** 2 + (path[i, 1] - position[1]) ** 2
        if squared < least:
            first, least = i, squared
    if first == path.shape[0] - 1:
        return path[first:].copy()
    starts = np.zeros(path.shape[0] - first)  # [m] of the waypoints, along the path from the first of them
    for i in range(first, path.shape[0] - 1):
        length = math.hypot(path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1])
        starts[i + 1 - first] = starts[i - first] + length
    count = math.ceil(starts[-1] / spacing)
    points, k = np.empty((count, 2)), 0
    for q in range(count):
        while k < len(starts) - 2 and starts[k + 1] <= q * spacing:
            k += 1
        length = max(starts[k + 1] - starts[k], 1e-12)
        for axis in range(2):
            before, after = path[first + k, axis], path[first + k + 1, axis]
            points[q, axis] = before + (after - before) / length * (q * spacing - starts[k])
    return points
