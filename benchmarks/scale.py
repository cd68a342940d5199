"""Time of a step of SLAM and memory of the map against its size, in one map and in local maps.

The filter is exact at every size: it has one covariance of all features, and computes its upper triangle. An update
with k pairings takes 2k multiplications for each entry, so that time and memory grow with n². Every step is a whole
`Slam.step` with JCBB and ten pairings, in a map of one feature per 6 m². The table also has the update alone, and one
symmetric rank-20 product by BLAS on a matrix as large as the covariance, the least time for such an update.

The second table contains drives over the lanes of a field with JCBB. In one map, the time of a step grows with n²; in
local maps, which are closed at a given size, it is constant. Features measured from two lanes are in two local maps
until all maps are joined by sparse least squares.

    python benchmarks/scale.py [--features 100 1000 5000]     # five minutes
"""

import math
from functools import partial

import numpy as np
from scipy.linalg.blas import dsyrk
from scipy.spatial import cKDTree

from benchmarks.common import Record, lanes, options, resident, table, timed
from slam_gym import LocalMapSlam, MapSpec, Odometry, Scan, Slam, SlamSpec, StochasticMap, jcbb
from slam_gym.geometry import observe, relative, transform
from slam_gym.simulation.surveyed_field import features_in_view
from slam_gym.types import Array

PAIRINGS = 10
REACH = 6.0  # [m] of the sensor
AREA = 6.0  # [m²] for each feature
STILL = Odometry.from_motion(np.zeros(3), 1e-3)
DRIFT = np.diag([0.02, 0.02, math.radians(0.3)]) ** 2  # covariance of the odometry of a step of the drive
SIGMA, DETECTION = 0.03, 0.9  # [m] of a measurement; fraction of the features in reach that is measured
WARM_UP = 20  # steps of a drive that may still compile something


def large_slam(features: int, rng: np.random.Generator) -> Slam:
    """A robot in the middle of a map of `features` features, all seen from one place; neighbours are covisible."""
    slam = Slam(SlamSpec(reach=REACH, map=MapSpec(unconfirmed_age=None)))
    side = math.sqrt(AREA * features)
    points = rng.uniform(-side / 2, side / 2, (features, 2))
    slam.map = StochasticMap(MapSpec(unconfirmed_age=None), capacity=features)
    slam.map.predict(STILL)
    slam.map.add(Scan.from_points(points, sigma=SIGMA), np.arange(features))
    slam.covisibility.add(features)
    slam.covisibility.link(cKDTree(slam.map.positions).query_pairs(REACH, output_type="ndarray"))
    return slam


def step_and_update(features: int, steps: int, rng: np.random.Generator) -> Record:
    """Median times in a map of one size."""
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
    """A drive over `count` features with one map (None) or local maps of `per_map` features, joined at the end."""
    rng, side, before = np.random.default_rng(seed), math.sqrt(AREA * count), resident()
    features, way = rng.uniform(0.0, side, (count, 2)), lanes(side, 8.0, 0.5)
    spec = SlamSpec(reach=REACH)
    slam = Slam(spec) if per_map is None else LocalMapSlam(spec, per_map)
    source: dict[int, int] = {}  # id of a map feature → true feature
    pose, times = way[0], []
    for waypoint in way:
        motion = relative(pose, waypoint) + rng.multivariate_normal(np.zeros(3), DRIFT)
        pose = waypoint
        seen = features_in_view(features, pose, REACH)
        seen = seen[rng.random(len(seen)) < DETECTION]
        points = observe(pose, features[seen]) + SIGMA * rng.standard_normal((len(seen), 2))
        step, microseconds = timed(slam.step, Odometry(motion, DRIFT), Scan.from_points(points, sigma=SIGMA), jcbb)
        times.append(microseconds)
        source |= dict(zip(step.ids[step.created].tolist(), seen[step.created].tolist()))
    maps = slam.maps
    bases = [np.zeros(3)] if isinstance(slam, Slam) else slam.bases
    ids = np.concatenate([m.ids for m in maps])
    places = transform(way[0], np.concatenate([transform(base, m.positions) for base, m in zip(bases, maps)]))
    row: Record = {"features": count, "map": "one" if per_map is None else "local", "maps": len(maps)}
    row |= {"step ms": 1e-3 * np.median(times[WARM_UP:]), "last tenth ms": 1e-3 * np.median(times[-len(times) // 10 :])}
    row |= {"memory MB": resident() - before} | map_errors(ids, places, features, source)
    if isinstance(slam, LocalMapSlam):
        joined, microseconds = timed(slam.smoothed)
        errors = map_errors(joined.ids, transform(way[0], joined.positions), features, source)
        row |= {"join s": 1e-6 * microseconds} | {f"{name}, joined": value for name, value in errors.items()}
    return row


def map_errors(ids: Array, places: Array, features: Array, source: dict[int, int]) -> Record:
    """RMS error of mapped features, each against the true feature from which it was started; number of duplicates."""
    sources = np.array([source[feature] for feature in ids.tolist()])
    error = np.hypot(*(places - features[sources]).T)
    return {"off m": math.sqrt(float(np.mean(error**2))), "duplicates": len(ids) - len(np.unique(sources))}


if __name__ == "__main__":
    features = (50, 100, 200, 500, 1000, 2000, 5000)
    a = options(__doc__, seed=0, features=features, steps=15, drives=(500, 1000, 5000), one_map=1000)
    sizes, drives, steps = ((50,), (50,), 3) if a.quick else (a.features, a.drives, a.steps)
    rows = [step_and_update(n, steps, np.random.default_rng(a.seed)) for n in sizes]
    table(f"Steps of {PAIRINGS} pairings by the size of the map; medians", rows)
    rows = [drive(n, per_map, a.seed) for n in drives for per_map in ((None, 100) if n <= a.one_map else (100,))]
    table("Drives over lanes, in one map and in local maps of 100 features", rows)
