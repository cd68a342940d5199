"""What a step of SLAM costs, and the memory that the map takes, against its size; and local maps against one map.

The filter is exact at every size: one covariance of all features, of which the upper triangle is worked on. An update
of k pairings takes 2k multiplications for each of its entries, so that time and memory grow with n². Every step is the
whole of `Slam.step` with JCBB, ten pairings, in a map of one feature per 6 m². Beside it stand the update alone and one
symmetric rank-20 product by BLAS on a matrix as large as the covariance, which is the least that such an update takes.

The second table has drives over lanes of a field, step by step with JCBB: in one map a step costs as much as its
square; in a local map, which is closed with so many features, it costs the same however far the robot has come. What is
measured from two lanes stands in two local maps until they are joined, all at once by sparse least squares.

    python benchmarks/scale.py [--features 100 1000 5000]     # five minutes
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from scipy.linalg.blas import dsyrk
from scipy.spatial import cKDTree

from benchmarks.common import Record, features_in_view, lanes, options, resident, table, timed
from slam_gym import LocalMapSlam, MapSpec, Odometry, Scan, Slam, SlamSpec, StochasticMap, jcbb
from slam_gym.geometry import observe, relative, transform
from slam_gym.mapping.covisibility import Edges, graph_of
from slam_gym.types import Array

PAIRINGS = 10
REACH = 6.0  # [m] of the sensor
AREA = 6.0  # [m²] for each feature
STILL = Odometry.from_motion(np.zeros(3), 1e-3)
DRIFT = np.diag([0.02, 0.02, math.radians(0.3)]) ** 2  # covariance of the odometry of a step of the drive
SIGMA, DETECTION = 0.03, 0.9  # [m] of a measurement; fraction of the features in reach that is reported
WARM_UP = 20  # steps of a drive that may still compile something


def large_slam(features: int, rng: np.random.Generator) -> Slam:
    """A robot in the middle of a map of so many features, all seen from one spot, neighbours seen together."""
    slam = Slam(SlamSpec(reach=REACH, map=MapSpec(unconfirmed_age=None)))
    side = math.sqrt(AREA * features)
    points = rng.uniform(-side / 2, side / 2, (features, 2))
    slam.map = StochasticMap(MapSpec(unconfirmed_age=None), capacity=features)
    slam.map.predict(STILL)
    slam.map.add(Scan.from_points(points, sigma=SIGMA), np.arange(features))
    pairs = cKDTree(slam.map.positions).query_pairs(REACH, output_type="ndarray").astype(np.int64)
    slam.covisibility = graph_of(features, Edges(pairs, np.full(len(pairs), 3)))
    return slam


def step_and_update(features: int, steps: int, rng: np.random.Generator) -> Record:
    """Medians of one size of the map."""
    before = resident()
    slam = large_slam(features, rng)
    near = np.argsort(np.hypot(*slam.map.positions.T))[:PAIRINGS]
    points, d = observe(slam.map.pose, slam.map.positions[near]), 3 + 2 * features
    factor, product = rng.normal(size=(2 * PAIRINGS, d)).T, np.zeros((d, d), order="F")
    multiply = partial(dsyrk, -1.0, factor, beta=1.0, c=product, overwrite_c=True)
    times = []
    for _ in range(steps + 1):
        scan = Scan.from_points(points + 0.01 * rng.standard_normal(points.shape), sigma=SIGMA)
        times.append(
            [timed(slam.step, STILL, scan, jcbb)[1], timed(slam.map.update, scan, near)[1], timed(multiply)[1]]
        )
    if slam.map.n != features:
        raise RuntimeError(f"{features} features have become {slam.map.n}")
    step, update, least = np.median(times[1:], axis=0).tolist()
    row = {"features": features, "step ms": 1e-3 * step, "update ms": 1e-3 * update, "dsyrk ms": 1e-3 * least}
    return row | {"update / dsyrk": update / least, "memory MB": resident() - before}


def drive(count: int, per_map: int | None, seed: int) -> Record:
    """A drive over so many features with one map (None) or local maps of so many, joined at its end."""
    rng, side, before = np.random.default_rng(seed), math.sqrt(AREA * count), resident()
    features, way = rng.uniform(0.0, side, (count, 2)), lanes(side, 8.0, 0.5)
    spec = SlamSpec(reach=REACH)
    slam = Slam(spec) if per_map is None else LocalMapSlam(spec, per_map)
    source: dict[int, int] = {}  # of each feature of the map, by its id
    pose, times = way[0], []
    for waypoint in way:
        motion = relative(pose, waypoint) + rng.multivariate_normal(np.zeros(3), DRIFT)
        pose = waypoint
        seen = features_in_view(features, pose, REACH)
        seen = seen[rng.random(len(seen)) < DETECTION]
        points = observe(pose, features[seen]) + SIGMA * rng.standard_normal((len(seen), 2))
        step, taken = timed(slam.step, Odometry(motion, DRIFT), Scan.from_points(points, sigma=SIGMA), jcbb)
        times.append(taken)
        source |= dict(zip(step.ids[step.created].tolist(), seen[step.created].tolist()))
    maps = [slam.map] if per_map is None else list(slam.maps)
    bases = [np.zeros(3)] if per_map is None else list(slam.bases)
    ids = np.concatenate([m.ids for m in maps])
    places = transform(way[0], np.concatenate([transform(base, m.positions) for base, m in zip(bases, maps)]))
    row: Record = {"features": count, "map": "one" if per_map is None else "local", "maps": len(maps)}
    row |= {"step ms": 1e-3 * np.median(times[WARM_UP:]), "last tenth ms": 1e-3 * np.median(times[-len(times) // 10 :])}
    row |= {"memory MB": resident() - before} | off(ids, places, features, source)
    if isinstance(slam, LocalMapSlam):
        whole, taken = timed(slam.smoothed)
        found = off(whole.ids, transform(way[0], whole.positions), features, source)
        row |= {"join s": 1e-6 * taken} | {f"{name}, joined": value for name, value in found.items()}
    return row


def off(ids: Array, places: Array, features: Array, source: dict[int, int]) -> Record:
    """By how much mapped features are off, root mean square, each against the one it was started from; duplicates."""
    sources = np.array([source[one] for one in ids.tolist()])
    error = np.hypot(*(places - features[sources]).T)
    return {"off m": math.sqrt(float(np.mean(error**2))), "duplicates": len(ids) - len(np.unique(sources))}


def main() -> None:
    a = options(
        __doc__, features=(50, 100, 200, 500, 1000, 2000, 5000), steps=15, drives=(500, 1000, 5000), one_map=1000
    )
    sizes, drives, steps = ((50,), (50,), 3) if a.quick else (a.features, a.drives, a.steps)
    rows = [step_and_update(n, steps, np.random.default_rng(a.seed)) for n in sizes]
    table(f"Steps of {PAIRINGS} pairings by the size of the map; medians", rows)
    rows = [drive(n, per_map, a.seed) for n in drives for per_map in ((None, 100) if n <= a.one_map else (100,))]
    table("Drives over lanes, in one map and in local maps of 100 features", rows)


if __name__ == "__main__":
    main()
