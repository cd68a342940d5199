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

from typing import NamedTuple

import numpy as np

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.bench.feature_index.cliques import PEERS, agreement, installed
from slam_gym.bench.feature_index.problems import point_map
from slam_gym.bench.feature_index.scaling import growth, scaling
from slam_gym.bench.feature_index.slam_maps import after_slam
from slam_gym.bench.records import Record
from slam_gym.bench.report import Report
from slam_gym.bench.speed.jcbb import summary
from slam_gym.bench.speed.loop_closure import CARRIED, closure_scan, mapped_field


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
        report.say(f"{name}: not installed: pip install slam_gym[bench]")
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
