"""What a step of SLAM costs, and the memory that the map takes, against its size.

The filter is exact at every size: one covariance of all features, of which the upper triangle is worked on. An update
of k pairings takes 2k multiplications for each of its entries, so that time and memory grow with n². Every step is the
whole of `Slam.step` with JCBB, in a map of one feature per 6 m²; in turns with it, one symmetric rank-2k product by
BLAS on a matrix as large as the covariance is timed, which is the least that such an update takes.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.linalg.blas import dsyrk
from scipy.spatial import cKDTree

from slam_gym.association import jcbb
from slam_gym.bench.memory import resident
from slam_gym.bench.records import Record, means, medians
from slam_gym.bench.report import Report
from slam_gym.bench.runner import UsageError
from slam_gym.bench.speed import lanes
from slam_gym.bench.speed.update import PAIRINGS, REACH, STILL, mapped
from slam_gym.bench.timing import THREAD, timed
from slam_gym.geometry import observe
from slam_gym.mapping.covisibility import Edges, graph_of
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Scan

_PRODUCTS = 3  # rank-2k products beside the steps: they take long where the map is large


def large_slam(features: int, rng: np.random.Generator) -> Slam:
    """A robot in the middle of a map of so many features, neighbours seen together."""
    slam = Slam(SlamSpec(reach=REACH, map=MapSpec(unconfirmed_age=None)))  # all of them were seen but once
    slam.map = mapped(features, rng)
    pairs = cKDTree(slam.map.positions).query_pairs(REACH, output_type="ndarray").astype(np.int64)
    slam.covisibility = graph_of(features, Edges(pairs, np.full(len(pairs), 3)))
    return slam


def measure(features: int, steps: int, rng: np.random.Generator) -> Record:
    """Medians of one size."""
    before = resident()
    slam = large_slam(features, rng)
    near = np.argsort(np.hypot(*slam.map.positions.T))[:PAIRINGS]
    points = observe(slam.map.pose, slam.map.positions[near])
    taken = []
    for _ in range(steps + 1):
        scan = Scan.from_points(points + 0.01 * rng.standard_normal(points.shape), sigma=0.03)
        one = timed(slam.step, STILL, scan, jcbb, clock=THREAD)
        taken.append({"µs": one.microseconds, "pairings": one.answer.hypothesis.pairings})
    held, d = resident() - before, 3 + 2 * features
    if slam.map.n != features:
        raise RuntimeError(f"{features} features have become {slam.map.n}")
    factor, product = rng.normal(size=(2 * PAIRINGS, d)).T, np.zeros((d, d), order="F")
    multiply = partial(dsyrk, -1.0, factor, beta=1.0, c=product, overwrite_c=True)
    products = [timed(multiply, clock=THREAD) for _ in range(_PRODUCTS)]
    step = medians(taken[1:], "µs")["µs"]
    least = float(np.median([one.microseconds for one in products]))
    return {
        "features": features,
        "step ms": 1e-3 * step,
        "steps/s": 1e6 / step,
        "dsyrk ms": 1e-3 * least,
        "step / dsyrk": step / least,
        **means(taken, "pairings"),
        "triangle MB": 4e-6 * d * d,
        "memory MB": held,
    }


def run(
    report: Report,
    *,
    features: tuple[int, ...] = (50, 100, 200, 500, 1000, 2000, 3000, 5000),
    steps: int = 15,
    drives: tuple[int, ...] = (500, 1000, 2000, 5000),
    exact: int = 1000,
    per_map: int = 100,
    seed: int = 0,
) -> None:
    """One row for each size of the map, and of drives that build one from nothing, in one map and in local maps.

    Arguments:
        features: map sizes
        steps: timed steps of each, from the second on
        drives: numbers of features that drives go over
        exact: up to so many, drives have one map as well, and local maps are joined
        per_map: features with which a local map is closed
        seed: of everything random
    """
    if min(features) < PAIRINGS or steps < 1:
        raise UsageError(f"at least {PAIRINGS} features and 1 step")
    rows = [measure(n, steps, np.random.default_rng(seed)) for n in features]
    report.table(f"Steps of {PAIRINGS} pairings by the size of the map", rows, "scale")
    rows = [
        lanes.measure(n, size, n <= exact, seed)
        for n in drives
        for size in ((None, per_map) if n <= exact else (per_map,))
    ]
    report.table(f"Drives over lanes, in one map and in local maps of {per_map} features", rows, "scale_drives")
