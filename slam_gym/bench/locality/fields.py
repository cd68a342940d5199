"""Maps of any size and scans to be relocated in them: the axes of the reference experiment.

A square field of point features (.02 per m²) is mapped in one lawn-mower pass, lanes 12 m apart, by a robot that sees
15 m far and 180° wide and scans every metre; `mapping_pass` tells with what errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slam_gym.bench.locality.mapping_pass import FieldSpec, drifted_map, lawn_mower_pass, sightings
from slam_gym.bench.sensing import clutter, features_in_view
from slam_gym.geometry import observe
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.locality import covisible, same_local_map, within
from slam_gym.types import UNPAIRED, Array, IntArray, Landmarks, Locality, Scan

LOCALITIES = ("covisibility", "two hops", "within 2r", "local maps", "joined maps", "everything")
_EXPERIMENT = FieldSpec()
_FIELD_OF_VIEW = math.pi  # [rad]
_POSES = 20_000  # drawn in search of one that sees enough


class Togetherness(NamedTuple):
    """What the pass tells of which features belong together."""

    in_scan: CovisibilityGraph  # seen in one scan
    in_map: CovisibilityGraph  # seen while one local map was built: each has a copy of what it sees
    map_of: IntArray  # (n,) local map in which each feature was first seen


@dataclass(frozen=True)
class SurveyedField:
    """A mapped field. Features are numbered in the order in which they were first seen."""

    spec: FieldSpec
    side: float  # [m]
    features: Array  # (n, 2) [m] true, in W = B
    landmarks: Landmarks
    path: Array  # (k, 3) [m, m, rad] poses of the mapping pass
    together: Togetherness

    def __len__(self) -> int:
        return len(self.features)

    def locality(self, name: str) -> Locality | None:
        """One of `LOCALITIES`. Raises ValueError for another name.

        Local maps: seen while the same one was built; features seen from two maps are local to both. Joined maps: the
        duplicates were made one, which stays with the older map.
        """
        makers: dict[str, Callable[[], Locality | None]] = {
            "covisibility": lambda: covisible(self.together.in_scan),
            "two hops": lambda: covisible(self.together.in_scan, hops=2),
            "within 2r": lambda: within(self.landmarks.positions, 2.0 * self.spec.reach),
            "local maps": lambda: covisible(self.together.in_map),
            "joined maps": lambda: same_local_map(self.together.map_of),
            "everything": lambda: None,
        }
        if name not in makers:
            raise ValueError(f"locality: {name!r} is none of {', '.join(LOCALITIES)}")
        return makers[name]()


@dataclass(frozen=True)
class FieldScan:
    """One scan to be relocated, and the truth behind it."""

    scan: Scan
    truth: IntArray  # (m,) feature behind each measurement, UNPAIRED for spurious ones
    pose: Array  # (3,) [m, m, rad] true, in W; NaN where it lies outside the map


def surveyed_field(n: int, rng: np.random.Generator, spec: FieldSpec = _EXPERIMENT) -> SurveyedField:
    """Draw a field of n features and map it in one pass. Raises ValueError for n < 1."""
    if n < 1:
        raise ValueError(f"n: {n} features")
    side = math.sqrt(n / spec.density)
    features, way = side * rng.random((n, 2)), lawn_mower_pass(side, spec)
    seen = sightings(features, way.poses, spec.reach)
    first = np.full(n, len(way.poses))
    for k in range(len(way.poses) - 1, -1, -1):
        first[seen[k]] = k
    if first.max() == len(way.poses):
        raise ValueError("the pass did not see every feature: lanes too far apart for the sensor's reach")
    order = np.argsort(first, kind="stable")
    number = np.empty(n, np.int64)
    number[order] = np.arange(n)
    features, first = features[order], first[order]
    together = _together([number[rows] for rows in seen], first, spec.local_map)
    return SurveyedField(spec, side, features, drifted_map(features, way, first, spec, rng), way.poses, together)


def inside(field: SurveyedField, m: int, spurious: int, rng: np.random.Generator) -> FieldScan:
    """A scan of m measurements from a random pose, in random order, `spurious` of them uniform in the field of view.

    Poses are drawn until one has m − spurious features in view. Raises RuntimeError where none is found.
    """
    for _ in range(_POSES):
        pose = np.array([*(field.side * rng.random(2)), rng.uniform(-math.pi, math.pi)])
        seen = features_in_view(field.features, pose, field.spec.reach, _FIELD_OF_VIEW)
        if len(seen) >= m - spurious:
            break
    else:
        raise RuntimeError(f"no pose in a field of {len(field)} features sees {m - spurious} of them")
    seen = rng.permutation(seen)[: m - spurious]
    strays = clutter(spurious, field.spec.reach, _FIELD_OF_VIEW, rng)
    points = np.concatenate([observe(pose, np.ascontiguousarray(field.features[seen])), strays])
    truth, order = np.concatenate([seen, np.full(spurious, UNPAIRED)]), rng.permutation(m)
    return FieldScan(_measured(points[order], field.spec, rng), truth[order], pose)


def outside(field: SurveyedField, m: int, rng: np.random.Generator) -> FieldScan:
    """A scan of m measurements from a place that is not in the map, of features as dense as the map's."""
    points = clutter(m, field.spec.reach, _FIELD_OF_VIEW, rng)
    return FieldScan(_measured(points, field.spec, rng), np.full(m, UNPAIRED), np.full(3, np.nan))


def from_centre(drawn: FieldScan) -> FieldScan:
    """The same scan with its measurements sorted by their distance from its centre."""
    points = drawn.scan.points
    order = np.argsort(np.hypot(*(points - points.mean(axis=0)).T), kind="stable")
    scan = Scan.from_points(points[order], drawn.scan.covariances[order])
    return FieldScan(scan, drawn.truth[order], drawn.pose)


def _together(seen: list[IntArray], first: IntArray, size: int) -> Togetherness:
    """From the features (…,) of each scan; a local map ends once it holds `size` of them."""
    in_scan, in_map = CovisibilityGraph(), CovisibilityGraph()
    in_scan.add(len(first))
    in_map.add(len(first))
    numbers, number, held = np.empty(len(seen), np.int64), 0, np.empty(0, np.int64)
    for k, features in enumerate(seen):
        in_scan.see_together(features)
        held = np.union1d(held, features)
        numbers[k] = number
        if len(held) >= size or k == len(seen) - 1:
            in_map.see_together(held)
            number, held = number + 1, np.empty(0, np.int64)
    return Togetherness(in_scan, in_map, numbers[first])


def _measured(points: Array, spec: FieldSpec, rng: np.random.Generator) -> Scan:
    """Noise of range and bearing, handed on in Cartesian form."""
    m = len(points)
    ranges = np.abs(np.hypot(points[:, 0], points[:, 1]) + spec.range_sigma * rng.standard_normal(m))
    bearings = np.arctan2(points[:, 1], points[:, 0]) + spec.bearing_sigma * rng.standard_normal(m)
    return Scan.from_polar(ranges, bearings, spec.range_sigma, spec.bearing_sigma)
