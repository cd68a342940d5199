"""A field mapped with known association, and scans that a robot takes there after it was carried elsewhere.

A robot maps a square field of point features in lanes. It is then carried to a random place, with an odometry that says
roughly where, and looks once: some features around it, in random number if need be, and clutter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slam_gym.bench.sensing import clutter, features_in_view
from slam_gym.geometry import compose, observe, relative
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import UNPAIRED, Array, IntArray, Odometry, Prediction, Scan

DENSITY = 0.6  # [1/m²]
RANGE = 6.0  # [m]
SPURIOUS = 0.3  # fraction of the measurements
DETECTION = 0.9  # fraction of the features in range that is reported
SIGMA = 0.03  # [m] of a measurement, in x and in y
CARRIED = np.array([0.45, 0.45, math.radians(2.0)])  # σ of the odometry before the loop closes
TRACKED = np.array([0.02, 0.02, math.radians(0.5)])  # σ of the odometry where there is no loop to close
_LANE = 8.0  # [m] between the lanes of the mapping drive
_STEP = np.diag([0.02, 0.02, math.radians(0.3)]) ** 2  # covariance of the odometry of the mapping drive
_PAIRED = 15  # mapped features, at most, that a scan of the mapping drive updates


@dataclass(frozen=True)
class MappedField:
    """Where the features are, what the map knows, and which feature each map entry stands for."""

    features: Array  # (n, 2) [m]
    map: StochasticMap
    identities: IntArray  # (n',) true feature behind each map feature
    pose: Array  # (3,) [m, m, rad] true pose at the end of the mapping drive

    @property
    def index(self) -> IntArray:
        """(n,) map entry of each feature, UNPAIRED where it has none."""
        index = np.full(len(self.features), UNPAIRED)
        index[self.identities] = np.arange(len(self.identities))
        return index

    def place(self, rng: np.random.Generator) -> Array:
        """A pose (3,) some way from the edges."""
        side = float(self.features.max())
        return np.array([*rng.uniform(0.2 * side, 0.8 * side, 2), rng.uniform(-math.pi, math.pi)])


@dataclass(frozen=True)
class ClosureScan:
    """One scan to associate."""

    scan: Scan
    prediction: Prediction
    truth: IntArray  # (m,) map feature behind each measurement, UNPAIRED where there is none

    def __len__(self) -> int:
        return len(self.scan)


def mapped_field(n: int, rng: np.random.Generator, density: float = DENSITY) -> MappedField:
    """A field of n features, `density` per m², mapped in one drive over its lanes with known association."""
    side = math.sqrt(n / density)
    features, waypoints = rng.uniform(0.0, side, (n, 2)), _lanes(side)
    pose = waypoints[0]
    stochastic_map, index = StochasticMap(MapSpec(), pose, capacity=n), np.full(n, UNPAIRED)
    for waypoint in waypoints:
        motion = relative(pose, waypoint)
        pose = compose(pose, motion)
        stochastic_map.predict(Odometry(motion + rng.multivariate_normal(np.zeros(3), _STEP), _STEP))
        _look_around(stochastic_map, index, features, pose, rng)
    mapped = np.flatnonzero(index != UNPAIRED)
    identities = np.empty(len(mapped), np.int64)
    identities[index[mapped]] = mapped
    return MappedField(features, stochastic_map, identities, pose)


def closure_scan(
    field: MappedField,
    m: int,
    sigma: Array,
    rng: np.random.Generator,
    *,
    spurious: float = 0.2,
    reach: float = RANGE,
) -> ClosureScan:
    """The robot is carried to a random place, with an odometry of σ `sigma` (3,), and sees m points there.

    A fraction `spurious` of them is clutter, the others are random ones of the features within `reach` [m].
    """
    carried, target = field.map.copy(), field.place(rng)
    covariance = np.diag(sigma**2)
    told = relative(field.pose, target) + rng.multivariate_normal(np.zeros(3), covariance)
    carried.predict(Odometry(told, covariance))
    seen = rng.permutation(features_in_view(field.features, target, reach))[: m - round(spurious * m)]
    strays = m - len(seen)
    points = np.concatenate([observe(target, field.features[seen]), clutter(strays, reach, math.tau, rng)])
    truth = np.concatenate([field.index[seen], np.full(strays, UNPAIRED)])
    order = np.argsort(np.arctan2(points[:, 1], points[:, 0]))
    return ClosureScan(_noisy(points[order], rng), carried.prediction(np.inf), truth[order])


def _lanes(side: float) -> Array:
    """Poses (w, 3), a metre apart, there and back over a square; all face along +x."""
    across, along = np.arange(min(_LANE, side) / 2.0, side, _LANE), np.arange(0.0, side, 1.0)
    return np.array([(x, y, 0.0) for k, y in enumerate(across) for x in along[:: 1 if k % 2 == 0 else -1]])


def _look_around(
    stochastic_map: StochasticMap, index: IntArray, features: Array, pose: Array, rng: np.random.Generator
) -> None:
    """A scan of everything within twice the range: some mapped features are paired, all others are added."""
    seen = features_in_view(features, pose, 2.0 * RANGE)
    new = np.flatnonzero(index[seen] == UNPAIRED)
    known = rng.permutation(np.flatnonzero(index[seen] != UNPAIRED))[:_PAIRED]
    scan = _noisy(observe(pose, features[seen]), rng)
    decisions = np.full(len(seen), UNPAIRED)
    decisions[known] = index[seen[known]]
    stochastic_map.update(scan, decisions)
    index[seen[new]] = stochastic_map.add(scan, new)


def _noisy(points: Array, rng: np.random.Generator) -> Scan:
    return Scan.from_points(points + SIGMA * rng.standard_normal(points.shape), sigma=SIGMA)
