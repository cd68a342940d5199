"""The compiled inner loops of `sensor.py`: what is in sight, what a scan makes of it, noisy ranges."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.types import SPURIOUS, Array, IntArray
from slam_gym.world.ray_casting import Grid, Movers, Packed, cast, movers_near, range_along, sees

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
    walls: Packed,
    pose: Array,
    features: tuple[Array, Array],
    moving: Moving,
    packed: PackedSettings,
    out: tuple[Array, IntArray],
) -> int:
    """How many of the features (positions and pull-backs) are in sight, and people (at their near side).

    The first array of `out` (N + p, 2) receives their true ranges and bearings, the second (N + p,) what they are.
    """
    grid, settings, (positions, pull_backs), (polar, sources) = Grid(*walls), Settings(*packed), features, out
    x, y = pose[0], pose[1]
    people, movers = moving[0], movers_near(x, y, settings.range, Movers(*moving))
    k = 0
    for i in range(positions.shape[0] + people.shape[0]):
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
        if not settings.min_range <= distance <= settings.range:
            continue
        bearing = wrap_angle(math.atan2(dy, dx) - pose[2])
        if abs(bearing) > 0.5 * settings.field_of_view:
            continue
        if not sees(grid, movers, x, y, dx, dy, short):
            continue
        polar[k, 0], polar[k, 1] = distance, bearing
        sources[k] = i if person < 0 else SPURIOUS
        k += 1
    return k


Measured = tuple[Array, Array, Array, Array, IntArray]
"""Room for a scan of up to n measurements: points (n, 2) [m] in R, covariances (n, 2, 2) [m²], sizes (n,) [m], their
variances (n,) [m²], sources (n,)."""


def room_for(n: int) -> Measured:
    """For n measurements."""
    return np.empty((n, 2)), np.empty((n, 2, 2)), np.empty(n), np.empty(n), np.empty(n, np.int64)


Finder = tuple[float, float]
"""Reach [m] and sigma [m] of a `BeamSpec`, for compiled functions."""


@compiled
def noisy_ranges(
    walls: Packed, pose: Array, bearings: Array, finder: Finder, moving: Moving, noise: Array, out: Array
) -> None:
    """Ranges (b,) along `bearings`, with noise where something was hit, kept within [0, reach], entered in `out`."""
    reach, sigma = finder
    free = cast(walls, pose, pose[2] + bearings, reach, moving)
    for b in range(len(bearings)):
        out[b] = min(max(free[b] + sigma * noise[b], 0.0), reach) if free[b] < reach else reach


@compiled
def measure(
    walls: Packed,
    pose: Array,
    seen: tuple[int, Array, IntArray],
    sizes: Array,
    moving: Moving,
    noise: tuple[Array, Array],
    packed: PackedSettings,
    out: tuple[Measured, tuple[Array, Finder, Array]],
) -> int:
    """A scan of what is `seen`, the answer of `in_sight` and its arrays, and the ranges of beams; length of the scan.

    `sizes` are those of all features, from which those of spurious measurements are drawn. `noise` are uniform and
    normal random numbers: three of each for each thing in sight, then for each piece of clutter, and normal ones for
    the beams. `out` receives the scan, and the ranges along the bearings in it (see `noisy_ranges`).
    """
    grid, settings, movers = Grid(*walls), Settings(*packed), Movers(*moving)
    (k, polar, sources), (uniform, normal), (scan, (bearings, finder, ranges)) = seen, noise, out
    noisy_ranges(walls, pose, bearings, finder, moving, normal[len(uniform) :], ranges)
    draws = len(uniform) // 3
    measured, origins = np.empty((3, draws)), np.empty(draws, np.int64)  # range, bearing, size; source
    n = 0
    for i in range(draws):
        size = sizes[int(uniform[3 * i + 2] * len(sizes))]
        source = sources[i] if i < k else SPURIOUS
        if i < k:
            if uniform[3 * i] >= (settings.detection if source >= 0 else settings.person_detection):
                continue
            sigma = math.hypot(settings.range_sigma, settings.range_sigma_ratio * polar[i, 0])
            distance = max(polar[i, 0] + sigma * normal[3 * i], settings.min_range)
            bearing = wrap_angle(polar[i, 1] + settings.bearing_sigma * normal[3 * i + 1])
            if source >= 0:
                size = sizes[source]
        else:  # uniform over the thin sector from the nearest range to the first surface
            bearing = settings.field_of_view * (uniform[3 * i] - 0.5)
            free = range_along(grid, pose[0], pose[1], pose[2] + bearing, settings.range, movers)
            low = settings.min_range**2
            distance = math.sqrt(low + uniform[3 * i + 1] * max(free * free - low, 0.0))
        measured[0, n], measured[1, n] = distance, bearing
        measured[2, n] = max(size + settings.size_sigma * normal[3 * i + 2], 0.0)
        origins[n] = source
        n += 1
    return _sweep(measured, origins, int(n), settings, scan)  # int: not the literal 0 as well


@compiled
def _sweep(measured: Array, origins: IntArray, count: int, settings: Settings, out: Measured) -> int:
    """The nearest `max_features` of the first `count` measurements (3, …), by rising bearing, made Cartesian."""
    points, covariances, sizes, size_variances, sources = out
    nearest = np.argsort(measured[0, :count], kind="mergesort")[: settings.max_features]
    order = nearest[np.argsort(measured[1][nearest], kind="mergesort")]
    for i in range(len(order)):
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
    return len(order)


class Wheels(NamedTuple):
    """An `OdometrySpec`, field by field, for compiled functions."""

    forward: float
    lateral: float
    turn_per_radian: float
    turn_per_metre: float
    floor: float
    slip_forward: float
    slip_lateral: float
    slip_turn: float
    slip_floor: float


PackedWheels = tuple[float, float, float, float, float, float, float, float, float]
"""`Wheels` as a plain tuple."""


@compiled
def report(packed: PackedWheels, way: Array, contact: bool, noise: Array, out: Array) -> None:
    """The wheels' report of one tick, with three normal random numbers: rows of `out` (4, 3), motion and covariance."""
    spec, dx, dy, turn = Wheels(*packed), way[0], way[1], way[2]
    distance = math.hypot(dx, dy)
    forward = spec.floor**2 + spec.forward**2 * distance
    lateral = spec.floor**2 + spec.lateral**2 * distance
    heading = spec.floor**2 + spec.turn_per_radian**2 * abs(turn) + spec.turn_per_metre**2 * distance
    out[0, 0] = dx + math.sqrt(forward) * noise[0]
    out[0, 1] = dy + math.sqrt(lateral) * noise[1]
    out[0, 2] = turn + math.sqrt(heading) * noise[2]
    if contact:  # what may have slipped is in the way of the wheels already
        forward += (spec.slip_forward * distance) ** 2 + spec.slip_floor**2
        lateral += (spec.slip_lateral * distance) ** 2 + spec.slip_floor**2
        heading += (spec.slip_turn * distance) ** 2 + spec.slip_floor**2
    out[1:] = 0.0
    out[1, 0], out[2, 1], out[3, 2] = forward, lateral, heading


@compiled
def report_and_in_sight(
    wheels: tuple[PackedWheels, Array, bool, Array, Array],
    walls: Packed,
    pose: Array,
    features: tuple[Array, Array],
    moving: Moving,
    packed: PackedSettings,
    out: tuple[Array, IntArray],
) -> int:
    """`report` and `in_sight` in one call from Python."""
    report(*wheels)
    return in_sight(walls, pose, features, moving, packed, out)
