"""The compiled inner loops of `sensor.py`: what is in sight, what a scan makes of it, noisy ranges."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.types import SPURIOUS, Array, IntArray
from slam_gym.world.ray_casting import Movers, cast, hides, movers_near, range_along, sees
from slam_gym.world.wall_grid import Grid, Packed

_SURFACE = 1e-3  # [m] a line of sight to a person ends so far before them


class Settings(NamedTuple):
    """A `SensorSpec`, field by field, for compiled functions."""

    range: float
    min_range: float
    field_of_view: float
    range_sigma: float
    range_sigma_ratio: float
    bearing_sigma: float
    size_sigma: float
    detection: float
    clutter: float
    person_detection: float
    max_features: int


Moving = tuple[Array, Array]
"""`Movers`, as a plain tuple."""

PackedSettings = tuple[float, float, float, float, float, float, float, float, float, float, int]
"""`Settings` as a plain tuple, which crosses from Python to compiled functions faster."""


@compiled
def in_sight(
    walls: Packed, pose: Array, positions: Array, pull_backs: Array, moving: Moving, packed: PackedSettings
) -> tuple[Array, IntArray]:
    """True range and bearing (k, 2) of the features in sight, then of the people (at their near side); sources (k,)."""
    grid, settings = Grid(*walls), Settings(*packed)
    x, y = pose[0], pose[1]
    people, movers = moving[0], movers_near(x, y, settings.range, Movers(*moving))
    count = positions.shape[0] + people.shape[0]
    polar, sources = np.empty((count, 2)), np.empty(count, np.int64)
    k = 0
    for i in range(count):
        person = i - positions.shape[0]
        if person < 0:
            dx, dy, surface = positions[i, 0] - x, positions[i, 1] - y, 0.0
            short = pull_backs[i]
        else:
            dx, dy, surface = people[person, 0] - x, people[person, 1] - y, people[person, 2]
            short = surface + _SURFACE
        if abs(dx) > settings.range + surface or abs(dy) > settings.range + surface:
            continue
        distance = math.hypot(dx, dy) - surface
        bearing = wrap_angle(math.atan2(dy, dx) - pose[2])
        if not settings.min_range <= distance <= settings.range or abs(bearing) > 0.5 * settings.field_of_view:
            continue
        if hides(x, y, dx, dy, short, movers) or not sees(grid, x, y, dx, dy, short):
            continue
        polar[k, 0], polar[k, 1] = distance, bearing
        sources[k] = i if person < 0 else SPURIOUS
        k += 1
    return polar[:k], sources[:k]


@compiled
def measure(
    walls: Packed,
    pose: Array,
    polar: Array,
    sources: IntArray,
    sizes: Array,
    moving: Moving,
    noise: Array,
    packed: PackedSettings,
) -> tuple[Array, Array, Array, Array, IntArray]:
    """A scan of what is in sight: points, covariances, sizes, their variances, and sources.

    `sizes` are those of all features, from which those of spurious measurements are drawn. `noise` (2, k + clutter, 3)
    are uniform and normal random numbers: a row for each thing in sight, then one for each piece of clutter.
    """
    grid, settings, movers = Grid(*walls), Settings(*packed), Movers(*moving)
    uniform, normal = noise[0], noise[1]
    k, draws = len(sources), len(uniform)
    measured, origins = np.empty((3, draws)), np.empty(draws, np.int64)  # range, bearing, size; source
    n = 0
    for i in range(draws):
        size = sizes[int(uniform[i, 2] * len(sizes))]
        source = sources[i] if i < k else SPURIOUS
        if i < k:
            if uniform[i, 0] >= (settings.detection if source >= 0 else settings.person_detection):
                continue
            sigma = math.hypot(settings.range_sigma, settings.range_sigma_ratio * polar[i, 0])
            distance = max(polar[i, 0] + sigma * normal[i, 0], settings.min_range)
            bearing = wrap_angle(polar[i, 1] + settings.bearing_sigma * normal[i, 1])
            if source >= 0:
                size = sizes[source]
        else:  # uniform over the thin sector from the nearest range to the first surface
            bearing = settings.field_of_view * (uniform[i, 0] - 0.5)
            free = range_along(grid, pose[0], pose[1], pose[2] + bearing, settings.range, movers)
            low = settings.min_range**2
            distance = math.sqrt(low + uniform[i, 1] * max(free * free - low, 0.0))
        measured[0, n], measured[1, n] = distance, bearing
        measured[2, n] = max(size + settings.size_sigma * normal[i, 2], 0.0)
        origins[n] = source
        n += 1
    return _sweep(measured, origins, int(n), settings)  # int: not the literal 0 as well


@compiled
def _sweep(
    measured: Array, origins: IntArray, count: int, settings: Settings
) -> tuple[Array, Array, Array, Array, IntArray]:
    """The nearest `max_features` of the first `count` measurements (3, …), by rising bearing, made Cartesian."""
    order = np.empty(count, np.int64)
    for i in range(count):
        order[i] = i
    _sort(order, count, measured[0])
    m = min(count, settings.max_features)
    _sort(order, m, measured[1])
    points, covariances = np.empty((m, 2)), np.empty((m, 2, 2))
    sizes, size_variances, sources = np.empty(m), np.empty(m), np.empty(m, np.int64)
    for i in range(m):
        r, bearing = measured[0, order[i]], measured[1, order[i]]
        c, s = math.cos(bearing), math.sin(bearing)
        along = settings.range_sigma**2 + (settings.range_sigma_ratio * r) ** 2
        across = (settings.bearing_sigma * r) ** 2
        points[i, 0], points[i, 1] = r * c, r * s
        covariances[i, 0, 0] = c * c * along + s * s * across
        covariances[i, 1, 1] = s * s * along + c * c * across
        covariances[i, 0, 1] = covariances[i, 1, 0] = c * s * (along - across)
        sizes[i], size_variances[i] = measured[2, order[i]], settings.size_sigma**2
        sources[i] = origins[order[i]]
    return points, covariances, sizes, size_variances, sources


@compiled
def _sort(order: IntArray, count: int, keys: Array) -> None:
    """Sort the first `count` indices in `order` by rising `keys`, by insertion: there are few."""
    for i in range(1, count):
        index, j = order[i], i
        while j > 0 and keys[order[j - 1]] > keys[index]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = index


@compiled
def noisy_ranges(
    walls: Packed, pose: Array, bearings: Array, reach: float, moving: Moving, sigma: float, noise: Array
) -> Array:
    """Ranges (b,) along `bearings`, with noise where something was hit, kept within [0, reach]."""
    ranges = cast(walls, pose, pose[2] + bearings, reach, moving)
    for b in range(len(ranges)):
        ranges[b] = min(max(ranges[b] + sigma * noise[b], 0.0), reach) if ranges[b] < reach else reach
    return ranges
