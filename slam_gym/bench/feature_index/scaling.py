"""What the feature index costs against the size of the map: building it, growing it, relocating with it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.bench.feature_index.problems import NEAR, SIGMA, Query, QueryKind, point_map, query
from slam_gym.bench.records import Record
from slam_gym.bench.timing import THREAD, fastest, timed

TARGETS = {1_000: (0.1, 0.25), 10_000: (0.3, 2.0), 100_000: (3.0, 30.0)}  # [ms] inside, refusing outside
_REACH, _NOISE = 11.0, 0.07  # [m] of an index that grows from nothing
_KINDS = (
    *(QueryKind(m, s, half) for m, s in ((10, 0.0), (10, 0.3), (20, 0.3), (20, 0.5)) for half in (False, True)),
    QueryKind(10, 0.3, half=False, inside=False),
    QueryKind(20, 0.5, half=False, inside=False),
)


def growth(n: int, rng: np.random.Generator) -> Record:
    """What building, adding feature by feature from none, and memory cost; means have all tables made anew in them."""
    landmarks = point_map(n, rng).landmarks
    built = timed(FeatureIndex, landmarks, clock=THREAD).microseconds
    index, covariance = FeatureIndex(reach=_REACH, noise=_NOISE), SIGMA**2 * np.eye(2)[None]
    times = [timed(index.add, p[None], covariance, clock=THREAD).microseconds for p in landmarks.positions]
    return {
        "n": n,
        **{"build, µs each": built / n, "add, median µs": float(np.median(times)), "mean": float(np.mean(times))},
        **{"mean of the last half": float(np.mean(times[n // 2 :])), "longest [ms]": 1e-3 * max(times)},
        **{"bytes each": index.nbytes / index.n, "triangles each": index.triangles / index.n},
    }


def scaling(sizes: Iterable[int], queries: int, rng: np.random.Generator) -> list[Record]:
    """Time, effort and outcome of relocations, by size of the map and kind of query."""
    rows = []
    for n in sizes:
        truth, landmarks = point_map(n, rng)
        index = FeatureIndex(landmarks)
        for kind in _KINDS:
            asked = [query(truth, kind, rng) for _ in range(queries)]
            target = TARGETS.get(n, (math.nan, math.nan))[0 if kind.inside else 1]
            rows.append({"n": n, **kind.row, **relocations(index, asked), "target [ms]": target})
    return rows


def relocations(index: FeatureIndex, asked: Sequence[Query]) -> Record:
    """Medians and fractions over queries."""
    answers = [index.relocate(one.scan) for one in asked]
    times = [1e-3 * fastest(index.relocate, one.scan, clock=THREAD) for one in asked]
    right = [a.accepted and NEAR.holds(a.pose, one.pose) for a, one in zip(answers, asked)]
    return {
        **{"ms": float(np.median(times)), "95 %": float(np.percentile(times, 95)), "right": float(np.mean(right))},
        "wrong": float(np.mean([a.accepted and not r for a, r in zip(answers, right)])),
        "ambiguous": float(np.mean([a.ambiguous for a in answers])),
        "poses": float(np.median([a.effort.nodes for a in answers])),
        "tests": float(np.median([a.effort.binary_tests for a in answers])),
    }
