"""Maps of any size and scans to be relocated in them: the axes of reference experiment B.

A square field of point features (.02 per m²) is mapped in one lawn-mower pass, lanes 12 m apart, by a robot that sees
15 m far and 180° wide and scans every metre. Its odometry drifts between stations 20 m apart along the pass, and what
it sees again of the lane before ties each station to its neighbour there: errors are carried by a Gaussian network over
the stations, so that they are large over the map and small between neighbours, as in a stochastic map. A feature is
drawn at the error of the place it was first seen from, plus an error of its own. All covariances are exact. Those of
pairs that no scan can span are left out, since they fail by distance whatever their covariance: a dense matrix of
12 800 features would be 5 GB.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from slam_gym.geometry import observe
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.locality import covisible, same_local_map, within
from slam_gym.types import NONE, UNKNOWN, Array, IntArray, Landmarks, Locality, Scan

LOCALITIES = ("covisibility", "two hops", "within 2r", "local maps", "joined maps", "everything")
_POSES = 20_000  # drawn in search of one that sees enough


@dataclass(frozen=True)
class FieldSpec:
    """What reference experiment B fixes, and the noise that it leaves open."""

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


@dataclass(frozen=True)
class Field:
    """A mapped field. Features are numbered in the order in which they were first seen."""

    spec: FieldSpec
    side: float  # [m]
    features: Array  # (n, 2) [m] true, in W = B
    landmarks: Landmarks
    path: Array  # (k, 3) [m, m, rad] poses of the mapping pass
    seen_together: CovisibilityGraph  # in one scan
    mapped_together: CovisibilityGraph  # in one local map: each has a copy of what it sees
    map_of: IntArray  # (n,) local map in which each feature was first seen

    def __len__(self) -> int:
        return len(self.features)

    def locality(self, name: str) -> Locality | None:
        """One of `LOCALITIES`. Raises ValueError for another name.

        Local maps: seen while the same one was built; features seen from two maps are local to both. Joined maps: the
        duplicates were made one, which stays with the older map.
        """
        if name == "everything":
            return None
        if name == "covisibility":
            return covisible(self.seen_together)
        if name == "two hops":
            return covisible(self.seen_together, hops=2)
        if name == "within 2r":
            return within(self.landmarks.positions, 2.0 * self.spec.reach)
        if name == "local maps":
            return covisible(self.mapped_together)
        if name == "joined maps":
            return same_local_map(self.map_of)
        raise ValueError(f"locality: {name!r} is none of {', '.join(LOCALITIES)}")


@dataclass(frozen=True)
class Look:
    """One scan to be relocated, and the truth behind it."""

    scan: Scan
    truth: IntArray  # (m,) feature behind each measurement, NONE = spurious
    pose: Array  # (3,) [m, m, rad] true, in W; NaN where it lies outside the map


def mapped_field(n: int, rng: np.random.Generator, spec: FieldSpec = FieldSpec()) -> Field:
    """Draw a field of n features and map it in one pass. Raises ValueError for n < 1."""
    if n < 1:
        raise ValueError(f"n: {n} features")
    side = math.sqrt(n / spec.density)
    features = side * rng.random((n, 2))
    path, arc = _pass(side, spec)
    seen = _sightings(features, path, spec.reach)
    first = np.full(n, len(path))
    for k in range(len(path) - 1, -1, -1):
        first[seen[k]] = k
    if first.max() == len(path):
        raise ValueError("the pass did not see every feature: lanes too far apart for the sensor's reach")
    order = np.argsort(first, kind="stable")
    rank = np.empty(n, np.int64)
    rank[order] = np.arange(n)
    features, first, seen = features[order], first[order], [rank[k] for k in seen]
    graph, maps, map_of = _graphs(n, seen, first, spec.local_map)
    landmarks = _drawn(features, path, arc, first, spec, rng)
    return Field(spec, side, features, landmarks, path, graph, maps, map_of)


def inside(field: Field, m: int, spurious: int, rng: np.random.Generator) -> Look:
    """A scan of m measurements from a random pose, in random order, `spurious` of them uniform in the field of view.

    Poses are drawn until one has m − spurious features in view. Raises RuntimeError where none is found.
    """
    for _ in range(_POSES):
        pose = np.array([*(field.side * rng.random(2)), rng.uniform(-math.pi, math.pi)])
        near = np.flatnonzero(np.abs(field.features - pose[:2]).max(axis=1) <= field.spec.reach)
        local = observe(pose, np.ascontiguousarray(field.features[near]))
        view = near[_in_view(local, field.spec.reach)]
        if len(view) >= m - spurious:
            break
    else:
        raise RuntimeError(f"no pose in a field of {len(field)} features sees {m - spurious} of them")
    view = rng.permutation(view)[: m - spurious]
    points = np.concatenate(
        [observe(pose, np.ascontiguousarray(field.features[view])), _half_disc(spurious, field, rng)]
    )
    truth, order = np.concatenate([view, np.full(spurious, NONE)]), rng.permutation(m)
    return Look(_measured(points[order], field.spec, rng), truth[order], pose)


def outside(field: Field, m: int, rng: np.random.Generator) -> Look:
    """A scan of m measurements from a place that is not in the map, of features as dense as the map's."""
    return Look(_measured(_half_disc(m, field, rng), field.spec, rng), np.full(m, NONE), np.full(3, np.nan))


def from_centre(look: Look) -> Look:
    """The same scan with its measurements sorted by their distance from its centre."""
    scan = look.scan
    order = np.argsort(np.hypot(*(scan.points - scan.points.mean(axis=0)).T), kind="stable")
    sizes, variances = scan.sizes[order], scan.size_variances[order]
    return Look(Scan(scan.points[order], scan.covariances[order], sizes, variances), look.truth[order], look.pose)


def _pass(side: float, spec: FieldSpec) -> tuple[Array, Array]:
    """Poses (k, 3) of the lawn-mower pass, and the arc length [m] of each, (k,)."""
    lanes = max(1, math.ceil(side / spec.lane))
    heights = (np.arange(lanes) + 0.5) * side / lanes
    corners = [(x, y) for k, y in enumerate(heights) for x in ((0.0, side) if k % 2 == 0 else (side, 0.0))]
    poses, arcs, start = [], [], 0.0
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        length = math.hypot(x1 - x0, y1 - y0)
        along = np.arange(0.0, length, spec.step)
        heading = math.atan2(y1 - y0, x1 - x0)
        leg = np.column_stack([x0 + along * math.cos(heading), y0 + along * math.sin(heading)])
        poses.append(np.column_stack([leg, np.full(len(along), heading)]))
        arcs.append(start + along)
        start += length
    return np.concatenate(poses), np.concatenate(arcs)


def _sightings(features: Array, path: Array, reach: float) -> list[IntArray]:
    """Features seen from each pose of the path."""
    near = cKDTree(features).query_ball_point(path[:, :2], reach, return_sorted=True)
    seen = []
    for pose, rows in zip(path, near):
        candidates = np.array(rows, np.int64)
        ahead = (features[candidates] - pose[:2]) @ np.array([math.cos(pose[2]), math.sin(pose[2])]) >= 0.0
        seen.append(candidates[ahead])
    return seen


def _graphs(
    n: int, seen: list[IntArray], first: IntArray, size: int
) -> tuple[CovisibilityGraph, CovisibilityGraph, IntArray]:
    """Seen in one scan; in one local map, which ends once it holds `size` features; local map of first sight (n,)."""
    graph, maps = CovisibilityGraph(), CovisibilityGraph()
    graph.add(n)
    maps.add(n)
    numbers, number, held = np.empty(len(seen), np.int64), 0, np.empty(0, np.int64)
    for k, features in enumerate(seen):
        graph.see_together(features)
        held = np.union1d(held, features)
        numbers[k] = number
        if len(held) >= size or k == len(seen) - 1:
            maps.see_together(held)
            number, held = number + 1, np.empty(0, np.int64)
    return graph, maps, numbers[first]


def _drawn(
    features: Array, path: Array, arc: Array, first: IntArray, spec: FieldSpec, rng: np.random.Generator
) -> Landmarks:
    """The map that the pass leaves: drifted positions and their exact covariance, of pairs that a scan can span."""
    n = len(features)
    K = _network(path, arc, spec)
    low = np.minimum((arc[first] / spec.station).astype(np.int64), len(K) - 2)
    share = arc[first] / spec.station - low
    drift = np.linalg.cholesky(K) @ rng.standard_normal((len(K), 2))
    drift = (1.0 - share)[:, None] * drift[low] + share[:, None] * drift[low + 1]
    positions = features + drift + spec.own * rng.standard_normal((n, 2))

    def between(j: IntArray, l: IntArray) -> Array:
        a, b = share[j], share[l]
        near = (1 - a) * ((1 - b) * K[low[j], low[l]] + b * K[low[j], low[l] + 1])
        return np.asarray(near + a * ((1 - b) * K[low[j] + 1, low[l]] + b * K[low[j] + 1, low[l] + 1]))

    every = np.arange(n)
    own = between(every, every) + spec.own**2
    spanned = within(positions, 2.0 * spec.reach + 6.0 * math.sqrt(2.0 * own.max()))
    row = np.repeat(every, np.diff(spanned.starts))
    cross = between(row, spanned.members)
    cross[row == spanned.members] = own
    unknown, eye = np.full(n, np.nan), np.eye(2)
    blocks = np.ascontiguousarray(cross[:, None, None] * eye)
    marginals = np.ascontiguousarray(own[:, None, None] * eye)
    return Landmarks(
        positions,
        marginals,
        unknown,
        unknown.copy(),
        np.full(n, UNKNOWN),
        np.empty((0, 0)),
        spanned.starts,
        spanned.members,
        blocks,
    )


def _network(path: Array, arc: Array, spec: FieldSpec) -> Array:
    """Covariance (s, s) [m²] per axis of the error at each station: the inverse of the network's precision.

    Odometry links each station to the next; what is seen again, to the nearest one of the lane before.
    """
    count = math.ceil(arc[-1] / spec.station) + 1
    at = np.minimum(np.searchsorted(arc, spec.station * np.arange(count)), len(path) - 1)
    places = path[at]
    links = [(k, k + 1, spec.along) for k in range(count - 1)]
    beside = 1.01 * math.hypot(spec.lane, 0.5 * spec.station)
    for k, near in enumerate(cKDTree(places[:, :2]).query_ball_point(places[:, :2], beside)):
        before = [l for l in near if l < k - 2]
        if before:
            gaps = np.hypot(*(places[before, :2] - places[k, :2]).T)
            links.append((k, before[int(gaps.argmin())], spec.across))
    precision = np.zeros((count, count))
    precision[0, 0] = 1.0 / spec.own**2  # the map's base is where the pass began
    for k, l, sigma in links:
        precision[[k, l], [k, l]] += sigma**-2
        precision[k, l] -= sigma**-2
        precision[l, k] -= sigma**-2
    covariance = np.linalg.inv(precision)
    return np.asarray(0.5 * (covariance + covariance.T))


def _in_view(local: Array, reach: float) -> IntArray:
    return np.flatnonzero((np.hypot(local[:, 0], local[:, 1]) <= reach) & (local[:, 0] >= 0.0))


def _half_disc(count: int, field: Field, rng: np.random.Generator) -> Array:
    radius, angle = field.spec.reach * np.sqrt(rng.random(count)), rng.uniform(-math.pi / 2, math.pi / 2, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _measured(points: Array, spec: FieldSpec, rng: np.random.Generator) -> Scan:
    """Noise of range and bearing, handed on in Cartesian form."""
    m = len(points)
    ranges = np.abs(np.hypot(points[:, 0], points[:, 1]) + spec.range_sigma * rng.standard_normal(m))
    bearings = np.arctan2(points[:, 1], points[:, 0]) + spec.bearing_sigma * rng.standard_normal(m)
    return Scan.from_polar(ranges, bearings, spec.range_sigma, spec.bearing_sigma)
