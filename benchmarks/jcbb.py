"""Searches with a prior at loop closure: accuracy and time.

A robot maps a square field of point features (0.6 per m²) in lanes, with known association. It is then carried
elsewhere with an uncertain odometry (σ 0.45 m, 0.45 m, 2°), so that each measurement has four to five candidates, and
scans once: 20 measurements, 30 % of them spurious, against all features of the map. `tracking` is a scan with a good
pose.

Searches are timed from the call in Python to the result: gating, joint covariance of the candidates, search. A scan is
`exact` if every decision is right; `recall` is the fraction of measurements of mapped features that are paired rightly,
`precision` the fraction of pairings that are right; `× JCBB` is the median ratio of times on the same scan.

    python benchmarks/jcbb.py       # two minutes
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.suite import association_record
from benchmarks.common import Record, fastest, lanes, options, table
from slam_gym import ASSOCIATORS, UNPAIRED, MapSpec, Odometry, Prediction, Scan, StochasticMap, jcbb
from slam_gym.association.compatibility import individual
from slam_gym.association.prediction import predict
from slam_gym.geometry import compose, observe, relative
from slam_gym.simulation.judged import CEILING
from slam_gym.simulation.surveyed_field import clutter, features_in_view
from slam_gym.types import Array, IntArray

DENSITY = 0.6  # [1/m²]
RANGE = 6.0  # [m]
SIGMA = 0.03  # [m] of a measurement, in x and in y
DETECTION = 0.9  # fraction of the features in range that is measured
STEP = np.diag([0.02, 0.02, math.radians(0.3)]) ** 2  # covariance of the odometry of the mapping drive
PAIRED = 15  # largest number of mapped features that a scan of the mapping drive updates


WORKLOADS = {
    "loop closure": (np.array([0.45, 0.45, math.radians(2.0)]), 0.3),
    "tracking": (np.array([0.02, 0.02, math.radians(0.5)]), 0.2),
}
"""Name → σ (3,) [m, m, rad] of the odometry before the scan, and the fraction of spurious measurements."""


@dataclass(frozen=True)
class MappedField:
    """A field of features, its map, and the map feature of each."""

    features: Array  # (n, 2) [m]
    map: StochasticMap
    index: IntArray  # (n,) map feature, UNPAIRED where there is none
    pose: Array  # (3,) [m, m, rad] true pose at the end of the mapping drive


ClosureScan = tuple[Scan, Prediction, IntArray]
"""One scan to associate, and the map feature (m,) behind each measurement, UNPAIRED where there is none."""


def mapped_field(n: int, rng: np.random.Generator) -> MappedField:
    """A field of n features mapped in one drive over its lanes with known association."""
    side = math.sqrt(n / DENSITY)
    features, waypoints = rng.uniform(0.0, side, (n, 2)), lanes(side, 8.0, 1.0)
    pose = waypoints[0]
    slam_map, index = StochasticMap(MapSpec(), pose, capacity=n), np.full(n, UNPAIRED)
    for waypoint in waypoints:
        motion = relative(pose, waypoint)
        pose = compose(pose, motion)
        slam_map.predict(Odometry(motion + rng.multivariate_normal(np.zeros(3), STEP), STEP))
        seen = features_in_view(features, pose, 2.0 * RANGE)
        new, known = (np.flatnonzero((index[seen] == UNPAIRED) == flag) for flag in (True, False))
        known = rng.permutation(known)[:PAIRED]
        decisions = np.full(len(seen), UNPAIRED)
        decisions[known] = index[seen[known]]
        scan = noisy(observe(pose, features[seen]), rng)
        slam_map.update(scan, decisions)
        index[seen[new]] = slam_map.add(scan, new)
    return MappedField(features, slam_map, index, pose)


def closure_scan(field: MappedField, m: int, workload: str, rng: np.random.Generator) -> ClosureScan:
    """A scan of m measurements at a random place, to which the robot is carried: the nearest features, and clutter."""
    sigma, fraction = WORKLOADS[workload]
    carried, side = field.map.copy(), float(field.features.max())
    target = np.array([*rng.uniform(0.2 * side, 0.8 * side, 2), rng.uniform(-math.pi, math.pi)])
    motion = relative(field.pose, target) + sigma * rng.standard_normal(3)
    carried.predict(Odometry(motion, np.diag(sigma**2)))
    spurious = round(fraction * m)
    reach = math.sqrt(2.0 * (m - spurious) / DETECTION / (math.tau * DENSITY))
    seen = features_in_view(field.features, target, 1.5 * reach)
    seen = seen[rng.random(len(seen)) < DETECTION]
    seen = seen[np.argsort(np.hypot(*(field.features[seen] - target[:2]).T))][: m - spurious]
    points = np.concatenate([observe(target, field.features[seen]), clutter(spurious, reach, math.tau, rng)])
    truth = np.concatenate([field.index[seen], np.full(spurious, UNPAIRED)])
    order = np.argsort(np.arctan2(points[:, 1], points[:, 0]))
    return noisy(points[order], rng), predict(carried, np.inf), truth[order]


def noisy(points: Array, rng: np.random.Generator) -> Scan:
    return Scan.from_points(points + SIGMA * rng.standard_normal(points.shape), sigma=SIGMA)


def compare(scans: list[ClosureScan]) -> list[Record]:
    """The accuracy and time [µs] of every search on the same scans."""
    problems, truths = [(scan, prediction) for scan, prediction, _ in scans], [truth for *_, truth in scans]
    rows, of_jcbb = [], np.array([fastest(jcbb, *problem) for problem in problems])
    for name, search in ASSOCIATORS.items():
        if name == CEILING:
            continue
        judged = association_record([search(*problem) for problem in problems], truths)
        times = np.array([fastest(search, *problem) for problem in problems])
        rows.append({
            "search": name,
            **{name: judged[name] for name in ("exact", "recall", "precision")},
            "median µs": np.median(times),
            "95 %": np.quantile(times, 0.95),
            "× JCBB": np.median(times / of_jcbb),
        })  # fmt: skip
    return sorted(rows, key=lambda row: row["median µs"])


if __name__ == "__main__":
    a = options(__doc__, seed=0, features=1000, scans=100)
    rng = np.random.default_rng(a.seed)
    n, scans = (30, 3) if a.quick else (a.features, a.scans)
    field = mapped_field(n, rng)
    for workload in WORKLOADS:
        drawn = [closure_scan(field, 20, workload, rng) for _ in range(scans)]
        each = np.mean([len(individual(scan, prediction).slots) / 20 for scan, prediction, _ in drawn])
        table(f"{workload}, 20 × {n}, {each:.1f} candidates each", compare(drawn))
