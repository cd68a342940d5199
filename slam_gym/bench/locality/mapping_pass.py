"""One lawn-mower pass over a field, and the errors with which a map is left by it.

The robot's odometry drifts between stations along the pass, and what it sees again of the lane before ties each station
to its neighbour there: errors are carried by a Gaussian network over the stations, so that they are large over the map
and small between neighbours, as in a stochastic map. A feature is drawn at the error of the place it was first seen
from, plus an error of its own. All covariances are exact. Those of pairs that no scan can span are left out, since they
fail by distance whatever their covariance: a dense matrix of 12 800 features would be 5 GB.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from slam_gym.mapping.locality import within
from slam_gym.types import Array, IntArray, Landmarks


@dataclass(frozen=True)
class FieldSpec:
    """What the reference experiment fixes, and the noise that it leaves open."""

    density: float = 0.02  # [1/m²]
    reach: float = 15.0  # [m] of the sensor, over the half plane ahead
    lane: float = 12.0  # [m] between lanes, at most
    step: float = 1.0  # [m] between scans of the pass
    station: float = 20.0  # [m] between nodes of the network that carries the drift
    along: float = 0.15  # [m] σ of the odometry from one station to the next
    across: float = 0.10  # [m] σ of a station relative to its neighbour in the lane before
    own: float = 0.05  # [m] σ of each feature's own error, per axis
    range_sigma: float = 0.05  # [m] of the sensor
    bearing_sigma: float = math.radians(0.25)  # of the sensor
    local_map: int = 50  # features after which a new local map begins


class Pass(NamedTuple):
    """The way of the robot."""

    poses: Array  # (k, 3) [m, m, rad]
    arcs: Array  # (k,) [m] driven until each


def lawn_mower_pass(side: float, spec: FieldSpec) -> Pass:
    """There and back over a square of `side` [m]."""
    lanes = max(1, math.ceil(side / spec.lane))
    heights = (np.arange(lanes) + 0.5) * side / lanes
    corners = [(x, y) for k, y in enumerate(heights) for x in ((0.0, side) if k % 2 == 0 else (side, 0.0))]
    poses, arcs, start = [], [], 0.0
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        length, heading = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
        along = np.arange(0.0, length, spec.step)
        leg = (x0 + along * math.cos(heading), y0 + along * math.sin(heading), np.full(len(along), heading))
        poses.append(np.column_stack(leg))
        arcs.append(start + along)
        start += length
    return Pass(np.concatenate(poses), np.concatenate(arcs))


def sightings(features: Array, poses: Array, reach: float) -> list[IntArray]:
    """Features seen from each pose, within `reach` [m] and ahead."""
    near = cKDTree(features).query_ball_point(poses[:, :2], reach, return_sorted=True)
    seen = []
    for pose, rows in zip(poses, near):
        candidates = np.array(rows, np.int64)
        ahead = (features[candidates] - pose[:2]) @ np.array([math.cos(pose[2]), math.sin(pose[2])]) >= 0.0
        seen.append(candidates[ahead])
    return seen


def drifted_map(features: Array, way: Pass, first: IntArray, spec: FieldSpec, rng: np.random.Generator) -> Landmarks:
    """The map of features (n, 2) first seen from poses `first` (n,), with blocks of the pairs that a scan can span."""
    K, n = station_covariance(way, spec), len(features)
    low = np.minimum((way.arcs[first] / spec.station).astype(np.int64), len(K) - 2)  # the station before
    weight = way.arcs[first] / spec.station - low  # of the station after
    drift = np.linalg.cholesky(K) @ rng.standard_normal((len(K), 2))
    drift = (1.0 - weight)[:, None] * drift[low] + weight[:, None] * drift[low + 1]
    positions = features + drift + spec.own * rng.standard_normal((n, 2))

    def between(j: IntArray, l: IntArray) -> Array:
        """Covariance [m²] per axis of the errors at the places that features j and l were first seen from."""
        a, b = weight[j], weight[l]
        near = (1 - a) * ((1 - b) * K[low[j], low[l]] + b * K[low[j], low[l] + 1])
        return np.asarray(near + a * ((1 - b) * K[low[j] + 1, low[l]] + b * K[low[j] + 1, low[l] + 1]))

    own = between(np.arange(n), np.arange(n)) + spec.own**2
    spanned = within(positions, 2.0 * spec.reach + 6.0 * math.sqrt(2.0 * own.max()))
    row = np.repeat(np.arange(n), np.diff(spanned.starts))
    cross = np.where(row == spanned.members, own[row], between(row, spanned.members))
    blocks = np.ascontiguousarray(cross[:, None, None] * np.eye(2))
    independent = Landmarks.from_points(positions, own[:, None, None] * np.eye(2))
    return replace(independent, block_starts=spanned.starts, block_columns=spanned.members, blocks=blocks)


def station_covariance(way: Pass, spec: FieldSpec) -> Array:
    """Covariance (s, s) [m²] per axis of the error at each station: the inverse of the network's precision.

    Odometry links each station to the next; what is seen again, to the nearest one of the lane before.
    """
    count = math.ceil(way.arcs[-1] / spec.station) + 1
    at = np.minimum(np.searchsorted(way.arcs, spec.station * np.arange(count)), len(way.poses) - 1)
    places = way.poses[at, :2]
    links = [(k, k + 1, spec.along) for k in range(count - 1)]
    beside = 1.01 * math.hypot(spec.lane, 0.5 * spec.station)
    for k, near in enumerate(cKDTree(places).query_ball_point(places, beside)):
        before = [l for l in near if l < k - 2]
        if before:
            gaps = np.hypot(*(places[before] - places[k]).T)
            links.append((k, before[int(gaps.argmin())], spec.across))
    precision = np.zeros((count, count))
    precision[0, 0] = 1.0 / spec.own**2  # the map's base is where the pass began
    for k, l, sigma in links:
        precision[[k, l], [k, l]] += sigma**-2
        precision[k, l] -= sigma**-2
        precision[l, k] -= sigma**-2
    covariance = np.linalg.inv(precision)
    return np.asarray(0.5 * (covariance + covariance.T))
