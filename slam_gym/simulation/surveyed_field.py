"""A surveyed field: a map of any size with realistic, correlated errors, and scans to relocate in it.

A square field of point features (0.02 per m²) is mapped in one lawn-mower pass, in lanes at most 12 m apart, by a robot
with a sensor of 15 m and 180°. Its odometry drifts between stations along the pass, and features seen again from the
previous lane link each station to its neighbour there: errors are large over the map and small between neighbours, as
in a stochastic map. Then the robot is lost, and scans once, inside the field or outside of it.
"""

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from slam_gym.geometry import observe
from slam_gym.mapping.locality import linked, same_local_map, within
from slam_gym.types import UNPAIRED, Array, IntArray, Landmarks, Locality, Scan
from slam_gym.validation import one_of

DENSITY = 0.02  # [1/m²]
REACH = 15.0  # [m] of the sensor, over the half plane ahead
LANE, STATION = 12.0, 20.0  # [m] between lanes, at most; between nodes of the network that carries the drift
ALONG, ACROSS, OWN = 0.15, 0.10, 0.05  # [m] σ from station to station, to the previous lane, of a feature itself
RANGE_SIGMA, BEARING_SIGMA = 0.05, math.radians(0.25)  # [m, rad] of the sensor
LOCAL_MAP = 50  # features after which a new local map begins
_DRAWS = 10_000  # most random poses drawn for a scan


@dataclass(frozen=True)
class FieldScan:
    """One scan to be relocated, and the truth behind it."""

    scan: Scan
    truth: IntArray  # (m,) feature behind each measurement, UNPAIRED for spurious ones
    pose: Array  # (3,) [m, m, rad] true, in W; NaN where it lies outside the map


@dataclass(frozen=True)
class SurveyedField:
    """A mapped field. Features are numbered in the order in which they were first seen."""

    side: float  # [m]
    features: Array  # (n, 2) [m] true, in W = B
    landmarks: Landmarks
    path: Array  # (k, 3) [m, m, rad] poses of the mapping pass
    in_scan: IntArray  # (e, 2) pairs seen in one scan
    in_map: IntArray  # (e, 2) pairs seen during one local map; each map has its own copies of features
    map_of: IntArray  # (n,) local map in which each feature was first seen

    def locality(self, name: str) -> Locality | None:
        """The locality of that name. Raises ValueError for a name that is not among `LOCALITIES`."""
        one_of("locality", name, LOCALITIES)
        return LOCALITIES[name](self)

    def scan_inside(self, m: int, spurious: int, rng: np.random.Generator) -> FieldScan:
        """A scan of m measurements in random order, `spurious` of them clutter, from a random pose inside the map.

        Raises ValueError for more clutter than measurements, and where none of many random poses has so many features
        in view.
        """
        if not 0 <= spurious <= m:
            raise ValueError(f"spurious: {spurious}, expected 0 … m = {m}")
        for _ in range(_DRAWS):
            pose = np.array([*(self.side * rng.random(2)), rng.uniform(-math.pi, math.pi)])
            seen = features_in_view(self.features, pose, REACH, math.pi)
            if len(seen) >= m - spurious:
                break
        else:
            raise ValueError(f"m={m}: none of {_DRAWS} poses has {m - spurious} features in view")
        seen = rng.permutation(seen)[: m - spurious]
        points = np.concatenate([observe(pose, self.features[seen]), clutter(spurious, REACH, math.pi, rng)])
        truth, order = np.concatenate([seen, np.full(spurious, UNPAIRED)]), rng.permutation(m)
        return FieldScan(_measured(points[order], rng), truth[order], pose)

    def scan_outside(self, m: int, rng: np.random.Generator) -> FieldScan:
        """A scan of m measurements from a place outside the map."""
        return FieldScan(_measured(clutter(m, REACH, math.pi, rng), rng), np.full(m, UNPAIRED), np.full(3, np.nan))


LOCALITIES: dict[str, Callable[[SurveyedField], Locality | None]] = {
    "covisibility": lambda field: linked(len(field.features), field.in_scan),
    "two hops": lambda field: linked(len(field.features), field.in_scan, hops=2),
    "within 2r": lambda field: within(field.landmarks.positions, 2.0 * REACH),
    "local maps": lambda field: linked(len(field.features), field.in_map),
    "joined maps": lambda field: same_local_map(field.map_of),
    "everything": lambda field: None,
}
"""In "local maps" two features are local to each other if they were seen during the same local map; in "joined maps",
if they were first seen during the same one."""


def surveyed_field(n: int, rng: np.random.Generator) -> SurveyedField:
    """Draw a field of n features and map it in one pass. The map lacks sizes and kinds."""
    side = math.sqrt(n / DENSITY)
    features, (poses, arcs) = side * rng.random((n, 2)), _lawn_mower_pass(side)
    seen = [features_in_view(features, pose, REACH, math.pi) for pose in poses]
    first = np.full(n, len(poses))
    for k in range(len(poses) - 1, -1, -1):
        first[seen[k]] = k
    order = np.argsort(first, kind="stable")
    number = np.argsort(order)
    features, first = features[order], first[order]
    in_map: list[IntArray] = []
    map_number, members = np.zeros(len(poses), np.int64), np.empty(0, np.int64)
    for k, rows in enumerate(seen):
        members = np.union1d(members, number[rows])
        map_number[k + 1 :] += len(members) >= LOCAL_MAP
        if len(members) >= LOCAL_MAP or k == len(seen) - 1:
            in_map.append(members)
            members = np.empty(0, np.int64)
    landmarks = _drifted_map(features, poses, arcs, first, rng)
    in_scan = _pairs_within(number[rows] for rows in seen)
    return SurveyedField(side, features, landmarks, poses, in_scan, _pairs_within(in_map), map_number[first])


def _pairs_within(groups: Iterable[IntArray]) -> IntArray:
    """(e, 2) all pairs i < j of two members of one group."""
    pairs = [np.sort(group)[np.column_stack(np.triu_indices(len(group), 1))] for group in groups]
    return np.unique(np.concatenate(pairs), axis=0)


def _lawn_mower_pass(side: float) -> tuple[Array, Array]:
    """Poses (k, 3), a metre apart, in lanes over a square of `side` [m]; and the path length (k,) [m] to each."""
    count = max(1, math.ceil(side / LANE))
    heights = (np.arange(count) + 0.5) * side / count
    corners = [(x, y) for k, y in enumerate(heights) for x in ((0.0, side) if k % 2 == 0 else (side, 0.0))]
    poses, arcs, start = [], [], 0.0
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        length, heading = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
        along = np.arange(0.0, length, 1.0)
        leg = (x0 + along * math.cos(heading), y0 + along * math.sin(heading), np.full(len(along), heading))
        poses.append(np.column_stack(leg))
        arcs.append(start + along)
        start += length
    return np.concatenate(poses), np.concatenate(arcs)


def _drifted_map(features: Array, poses: Array, arcs: Array, first: IntArray, rng: np.random.Generator) -> Landmarks:
    """The map of features (n, 2) first seen from poses `first` (n,), with exact cross-covariances of near pairs."""
    K, n = _station_covariance(poses, arcs), len(features)
    low = np.minimum((arcs[first] / STATION).astype(np.int64), len(K) - 2)  # the previous station
    weight = arcs[first] / STATION - low  # of the next station
    drift = np.linalg.cholesky(K) @ rng.standard_normal((len(K), 2))
    drift = (1.0 - weight)[:, None] * drift[low] + weight[:, None] * drift[low + 1]
    positions = features + drift + OWN * rng.standard_normal((n, 2))

    def between(j: IntArray, l: IntArray) -> Array:
        """Covariance [m²] per axis of the errors at the places from which features j and l were first seen."""
        a, b = weight[j], weight[l]
        before = (1 - a) * ((1 - b) * K[low[j], low[l]] + b * K[low[j], low[l] + 1])
        return np.asarray(before + a * ((1 - b) * K[low[j] + 1, low[l]] + b * K[low[j] + 1, low[l] + 1]))

    variances = between(np.arange(n), np.arange(n)) + OWN**2
    # of pairs that a scan can span: other pairs fail the distance test, and all take 5 GB for 12 800 features
    spanned = within(positions, 2.0 * REACH + 6.0 * math.sqrt(2.0 * variances.max()))
    row = np.repeat(np.arange(n), np.diff(spanned.starts))
    cross = np.where(row == spanned.members, variances[row], between(row, spanned.members))
    blocks = np.ascontiguousarray(cross[:, None, None] * np.eye(2))
    independent = Landmarks.from_points(positions, variances[:, None, None] * np.eye(2))
    return replace(independent, block_starts=spanned.starts, block_columns=spanned.members, blocks=blocks)


def _station_covariance(poses: Array, arcs: Array) -> Array:
    """Covariance (s, s) [m²] per axis of the error at each station: the inverse of the network's precision."""
    count = math.ceil(arcs[-1] / STATION) + 1
    places = poses[np.minimum(np.searchsorted(arcs, STATION * np.arange(count)), len(poses) - 1), :2]
    links = [(k, k + 1, ALONG) for k in range(count - 1)]  # by odometry; below, by features seen again
    for k, near in enumerate(cKDTree(places).query_ball_point(places, 1.01 * math.hypot(LANE, 0.5 * STATION))):
        before = [l for l in near if l < k - 2]
        if before:
            gaps = np.hypot(*(places[before] - places[k]).T)
            links.append((k, before[int(gaps.argmin())], ACROSS))
    precision = np.zeros((count, count))
    precision[0, 0] = 1.0 / OWN**2  # the map's base is the start of the pass
    for k, l, sigma in links:
        precision[[k, l], [k, l]] += sigma**-2
        precision[[k, l], [l, k]] -= sigma**-2
    covariance = np.linalg.inv(precision)
    return np.asarray(0.5 * (covariance + covariance.T))


def _measured(points: Array, rng: np.random.Generator) -> Scan:
    """A scan of points (m, 2) [m] in R, with the noise of the sensor."""
    ranges = np.abs(np.hypot(*points.T) + RANGE_SIGMA * rng.standard_normal(len(points)))
    bearings = np.arctan2(points[:, 1], points[:, 0]) + BEARING_SIGMA * rng.standard_normal(len(points))
    return Scan.from_polar(ranges, bearings, RANGE_SIGMA, BEARING_SIGMA)


def features_in_view(features: Array, pose: Array, reach: float, field_of_view: float = math.tau) -> IntArray:
    """Rows of `features` (n, 2) [m] within `reach` [m] of a pose (3,) and within the `field_of_view` [rad]."""
    near = np.flatnonzero(np.abs(features - pose[:2]).max(axis=1, initial=0.0) <= reach)
    local = observe(pose, np.ascontiguousarray(features[near]))
    ahead = np.abs(np.arctan2(local[:, 1], local[:, 0])) <= 0.5 * field_of_view
    return near[ahead & (np.hypot(local[:, 0], local[:, 1]) <= reach)]


def clutter(count: int, reach: float, field_of_view: float, rng: np.random.Generator) -> Array:
    """Points (count, 2) [m] in R, uniform over the field of view of the sensor."""
    radius = reach * np.sqrt(rng.random(count))
    bearing = rng.uniform(-0.5 * field_of_view, 0.5 * field_of_view, count)
    return np.column_stack([radius * np.cos(bearing), radius * np.sin(bearing)])
