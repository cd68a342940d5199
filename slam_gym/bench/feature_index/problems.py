"""Maps of points and scans to be relocated in them.

Maps of point features at 1/16 per m² with independent errors of .05 m; the robot sees the k features nearest to it, or
a random half of the 2k nearest, each with an error of .05 m, and spurious measurements over the same disc. Sizes are
not used.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym.bench.answers import Tolerance
from slam_gym.bench.records import Record
from slam_gym.bench.sensing import clutter
from slam_gym.geometry import observe
from slam_gym.types import Array, Landmarks, Scan

SIGMA = 0.05  # [m] of features in the map, and of measurements
DENSITY = 1.0 / 16.0  # [1/m²]
NEAR = Tolerance(0.3, math.radians(3.0))  # of a pose that is right


class PointMap(NamedTuple):
    """Features, and a map of them."""

    truth: Array  # (n, 2) [m]
    landmarks: Landmarks


class Query(NamedTuple):
    """One scan, and where it was taken; NaN outside the map."""

    scan: Scan
    pose: Array  # (3,) [m, m, rad]


class QueryKind(NamedTuple):
    """How scans are drawn."""

    m: int
    spurious: float  # fraction of the measurements
    half: bool  # a random half of the features around is seen, not all
    inside: bool = True  # otherwise of features that the map does not hold

    @property
    def row(self) -> Record:
        """As tables have it."""
        seen = "half" if self.half else "all"
        return {"m": self.m, "spurious": self.spurious, "seen": seen, "inside": self.inside}


def point_map(n: int, rng: np.random.Generator) -> PointMap:
    """Features anywhere in a square."""
    truth = rng.uniform(0.0, math.sqrt(n / DENSITY), (n, 2))
    return PointMap(truth, Landmarks.from_points(truth + SIGMA * rng.standard_normal((n, 2)), sigma=SIGMA))


def query(truth: Array, kind: QueryKind, rng: np.random.Generator) -> Query:
    """A scan from a random place among true features (n, 2)."""
    side, seen = math.sqrt(len(truth) / DENSITY), kind.m - round(kind.spurious * kind.m)
    pose = np.array([*rng.uniform(0.15 * side, 0.85 * side, 2), rng.uniform(-math.pi, math.pi)])
    features = truth if kind.inside else rng.uniform(0.0, side, truth.shape)
    distances = np.hypot(*(features - pose[:2]).T)
    near = np.argpartition(distances, 2 * seen)[: 2 * seen]
    near = near[np.argsort(distances[near])][: 2 * seen if kind.half else seen]
    strays = clutter(kind.m - seen, float(distances[near[-1]]), math.tau, rng)
    points = np.concatenate([observe(pose, features[rng.permutation(near)[:seen]]), strays])[rng.permutation(kind.m)]
    scan = Scan.from_points(points + SIGMA * rng.standard_normal((kind.m, 2)), sigma=SIGMA)
    return Query(scan, pose if kind.inside else np.full(3, math.nan))
