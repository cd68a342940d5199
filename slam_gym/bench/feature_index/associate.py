"""Relocation by the feature index: time against map size, success beside exact cliques, and maps from a SLAM run.

Maps of point features at 1/16 per m² with independent errors of .05 m; the robot sees the k features nearest to it, or
a random half of the 2k nearest, each with an error of .05 m, and spurious measurements over the same disc. Sizes are
not used. Peers see the same scans: the maximum clique of the graph of binary-consistent pairings (distances within the
.99 gate), which is built here in numpy, from the pairs of features sorted by length once per map, and timed apart from
the clique itself.

All times are of the processor, not of the clock: of the thread for the index, of the process for peers, so that what
else the machine does counts little (its use of memory and caches still does). They are medians over queries of the
least of a few calls. Last comes JCBB at loop closure, of which `jcbb` has the rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.bench.feature_index.cliques import PEERS, agreement, installed
from slam_gym.bench.feature_index.problems import NEAR, SIGMA, Query, QueryKind, point_map, query
from slam_gym.bench.feature_index.slam_maps import after_slam
from slam_gym.bench.records import Record
from slam_gym.bench.report import Report
from slam_gym.bench.speed.jcbb import summary
from slam_gym.bench.speed.loop_closure import CARRIED, closure_scan, mapped_field
from slam_gym.bench.timing import THREAD, fastest, timed

TARGETS = {1_000: (0.1, 0.25), 10_000: (0.3, 2.0), 100_000: (3.0, 30.0)}  # [ms] inside, refusing outside
_REACH, _NOISE = 11.0, 0.07  # [m] of an index that grows from nothing
_KINDS = (
    *(QueryKind(m, s, half) for m, s in ((10, 0.0), (10, 0.3), (20, 0.3), (20, 0.5)) for half in (False, True)),
    QueryKind(10, 0.3, half=False, inside=False),
    QueryKind(20, 0.5, half=False, inside=False),
    QueryKind(20, 0.5, half=True, inside=False),
)


class Workload(NamedTuple):
    """How much is run."""

    sizes: tuple[int, ...]  # of maps
    queries: int  # per row
    clique_sizes: tuple[int, ...]  # of maps in which cliques are searched for
    clique_queries: int
    clique_seconds: float  # that a peer may take for a row
    seeds: int  # of maps from SLAM
    closures: int  # scans at loop closure


FULL = Workload((1_000, 10_000, 100_000), 40, (100, 400, 1_000), 40, 10.0, 5, 150)
QUICK = Workload((1_000, 10_000), 15, (100,), 8, 0.5, 1, 40)


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
        **{
            "ms": float(np.median(times)),
            "95 %": float(np.percentile(times, 95)),
            "longest": max(times),
            "right": float(np.mean(right)),
        },
        "wrong": float(np.mean([a.accepted and not r for a, r in zip(answers, right)])),
        "ambiguous": float(np.mean([a.ambiguous for a in answers])),
        "limit hit": float(np.mean([a.effort.limit_hit for a in answers])),
        "poses": float(np.median([a.effort.nodes for a in answers])),
        "tests": float(np.median([a.effort.binary_tests for a in answers])),
    }


def loop_closure(problems: int, rng: np.random.Generator) -> Record:
    """JCBB's time and whole scans right in a map of 1 000 features, 20 measurements a scan."""
    made = mapped_field(1_000, rng)
    found = summary(closure_scan(made, 20, CARRIED, rng) for _ in range(problems))
    return {"problems": problems} | {name: found[name] for name in ("candidates each", "scans exact", "JCBB")}


def run(report: Report, *, quick: bool = False, seed: int = 0) -> None:
    """Five tables.

    Arguments:
        quick: small maps and few queries: under a minute
        seed: of everything random
    """
    w, rng, peers = QUICK if quick else FULL, np.random.default_rng(seed), installed()
    for name in PEERS.keys() - peers:
        report.say(f"{name}: not installed: pip install 'slam_gym[bench]'")
    FeatureIndex(point_map(100, rng).landmarks)  # compiles, or loads what was compiled
    report.table("Building, and growing one by one", [growth(n, rng) for n in w.sizes], "associate_growth")
    title = "Relocation; right and wrong count accepted answers only"
    report.table(title, scaling(w.sizes, w.queries, rng), "associate_scaling")
    title = "Success (pose within .3 m and 3°, accepted or not) beside exact cliques; ratio: clique alone / index"
    report.table(title, agreement(w.clique_sizes, w.clique_queries, peers, w.clique_seconds, rng), "associate_cliques")
    title = "Maps from SLAM: right if most pairings are (the corridor's four sides are alike: nothing decides)"
    report.table(title, after_slam(w.seeds, rng), "associate_slam")
    title = "JCBB at loop closure, 20 measurements × 1 000 features [µs]; targets: 150 µs, .90 exact"
    report.table(title, [loop_closure(w.closures, rng)], "associate_jcbb")
