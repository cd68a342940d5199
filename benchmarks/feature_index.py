"""Relocation by the feature index: answers inside and outside maps of 1 000, 10 000 and 100 000 features.

Maps contain point features at 1/16 per m² with independent errors of 0.05 m. The robot sees the k nearest features, or
a random half of the 2k nearest, each with an error of 0.05 m, and spurious measurements over the same disc. Sizes are
not used. Times are CPU times, medians over scans of the least of three calls; right (within 0.3 m and 3°) and wrong
count accepted answers only.

    python benchmarks/feature_index.py       # four minutes
"""

import math
from typing import NamedTuple

import numpy as np
import pandas as pd

from benchmarks.common import Record, fastest, options, table, timed
from slam_gym import Landmarks, Scan
from slam_gym.association.relocation.triangles import FeatureIndex
from slam_gym.geometry import observe
from slam_gym.simulation.kidnapping import is_right
from slam_gym.simulation.surveyed_field import clutter
from slam_gym.types import Array

SIGMA = 0.05  # [m] of features in the map, and of measurements
DENSITY = 1.0 / 16.0  # [1/m²]
NEAR = 0.3, math.radians(3.0)  # of a right pose


class ScanKind(NamedTuple):
    """A kind of scans."""

    m: int
    spurious: float  # fraction of the measurements
    half: bool  # a random half of the features around is seen, not all
    inside: bool = True  # otherwise of features that are not in the map


KINDS = (
    *(ScanKind(m, s, half) for m, s in ((10, 0.0), (10, 0.3), (20, 0.3), (20, 0.5)) for half in (False, True)),
    *(ScanKind(m, s, half, inside=False) for m, s, half in ((10, 0.3, False), (20, 0.5, False), (20, 0.5, True))),
)


def point_map(n: int, rng: np.random.Generator) -> tuple[Array, Landmarks]:
    """Features (n, 2) [m], uniform over a square, and a map of them."""
    truth = rng.uniform(0.0, math.sqrt(n / DENSITY), (n, 2))
    return truth, Landmarks.from_points(truth + SIGMA * rng.standard_normal((n, 2)), sigma=SIGMA)


def query(truth: Array, kind: ScanKind, rng: np.random.Generator) -> tuple[Scan, Array]:
    """A scan from a random place among true features (n, 2), and its pose (3,); NaN outside the map."""
    side, seen = math.sqrt(len(truth) / DENSITY), kind.m - round(kind.spurious * kind.m)
    pose = np.array([*rng.uniform(0.15 * side, 0.85 * side, 2), rng.uniform(-math.pi, math.pi)])
    features = truth if kind.inside else rng.uniform(0.0, side, truth.shape)
    distances = np.hypot(*(features - pose[:2]).T)
    near = np.argpartition(distances, 2 * seen)[: 2 * seen]
    near = near[np.argsort(distances[near])][: 2 * seen if kind.half else seen]
    spurious = clutter(kind.m - seen, float(distances[near[-1]]), math.tau, rng)
    points = np.concatenate([observe(pose, features[rng.permutation(near)[:seen]]), spurious])[rng.permutation(kind.m)]
    scan = Scan.from_points(points + SIGMA * rng.standard_normal((kind.m, 2)), sigma=SIGMA)
    return scan, pose if kind.inside else np.full(3, math.nan)


def relocations(index: FeatureIndex, queries: list[tuple[Scan, Array]]) -> Record:
    """Times [ms] and outcomes of the index."""
    rows = []
    for scan, pose in queries:
        answer = index.relocate(scan)
        right = is_right(answer.pose, pose, *NEAR)
        verdict = {"right": answer.accepted and right, "wrong": answer.accepted and not right}
        verdict |= {"limit hit": answer.effort.limit_hit, "ambiguous": answer.ambiguous}
        rows.append({"ms": 1e-3 * fastest(index.relocate, scan, repeats=3), **verdict})
    results = pd.DataFrame(rows)
    times = {"ms": results["ms"].median(), "95 %": results["ms"].quantile(0.95), "longest": results["ms"].max()}
    return times | results.drop(columns="ms").mean().to_dict()


if __name__ == "__main__":
    a = options(__doc__, seed=0, sizes=(1_000, 10_000, 100_000), scans=40)
    rng, scans = np.random.default_rng(a.seed), 2 if a.quick else a.scans
    sizes = (300,) if a.quick else a.sizes
    FeatureIndex(point_map(100, rng)[1])  # compiles
    rows, built = [], []
    for n in sizes:
        truth, landmarks = point_map(n, rng)
        index, microseconds = timed(FeatureIndex, landmarks)
        built.append({"n": n, "µs per feature": microseconds / n})
        for kind in KINDS:
            queries = [query(truth, kind, rng) for _ in range(scans)]
            rows.append({"n": n, **kind._asdict(), **relocations(index, queries)})
    table("Building", built)
    table("Relocation by the index", rows)
