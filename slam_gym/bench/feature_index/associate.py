"""Relocation by the feature index: time against map size, success beside exact cliques, and maps from a SLAM run.

Maps of point features at 1/16 per m² with independent errors of .05 m; the robot sees the k features nearest to it, or
a random half of the 2k nearest, each with an error of .05 m, and spurious measurements over the same disc. Sizes are
not used. Peers see the same scans: the maximum clique of the graph of binary-consistent pairings (distances within the
.99 gate), which is built here in numpy, from the
pairs of features sorted by length once per map, and timed apart from the clique itself.

All times are of the processor, not of the clock: `time.thread_time` for the index, `time.process_time` for peers, so
that what else the machine does counts little (its use of memory and caches still does).
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from threadpoolctl import threadpool_limits

import slam_gym  # noqa: F401  (registers the environments)
from slam_gym.association.relocation.acceptance import min_pairings
from slam_gym.association.relocation.location import locate
from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.association.triangles.map import relative_covariances
from slam_gym.bench.feature_index.problems import (
    CLIQUES,
    SIGMA,
    Query,
    consistency_edges,
    field,
    installed,
    is_right,
    milliseconds,
    pairs_by_length,
    query,
)
from slam_gym.bench.speed import jcbb as jcbb_bench
from slam_gym.bench.speed.step import Pilot
from slam_gym.metrics.association import Identities
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NONE, IntArray, Landmarks, Scan
from slam_gym.world.corridor import RANGE, walk_round

TARGETS = {1_000: (0.1, 0.25), 10_000: (0.3, 2.0), 100_000: (3.0, 30.0)}  # [ms] inside, refusing outside
Row = dict[str, Any]


# index: time against map size


def scaling(sizes: Iterable[int], queries: int, repeats: int, rng: np.random.Generator) -> list[Row]:
    """Time, effort and outcome of relocations, by size of the map."""
    rows = []
    for n in sizes:
        truth, landmarks = field(n, rng)
        index = FeatureIndex(landmarks)
        workloads = [(10, 0.0), (10, 0.3), (20, 0.3), (20, 0.5)]
        for m, spurious, half, inside in [
            *((m, s, half, True) for m, s in workloads for half in (False, True)),
            (10, 0.3, False, False),
            (20, 0.5, False, False),
        ]:
            asked = [query(truth, m, spurious, half, inside, rng) for _ in range(queries)]
            rows.append({"n": n, "m": m, "spurious": spurious, "seen": ("all", "half")[half], "inside": inside})
            rows[-1] |= relocations(index, asked, repeats)
            target = TARGETS.get(n, (math.nan, math.nan))[0 if inside else 1]
            rows[-1]["target_ms"] = target
            _line(rows[-1])
    return rows


def relocations(index: FeatureIndex, asked: list[Query], repeats: int) -> Row:
    """Medians over queries."""
    answers = [index.relocate(one.scan) for one in asked]
    times = [milliseconds(lambda one=one: index.relocate(one.scan), repeats) for one in asked]  # type: ignore[misc]
    right = [a.accepted and is_right(a.pose, one.pose) for a, one in zip(answers, asked)]
    return {
        "ms": float(np.median(times)),
        "ms_95": float(np.percentile(times, 95)),
        "right": float(np.mean(right)),
        "wrong": float(np.mean([a.accepted and not r for a, r in zip(answers, right)])),
        "ambiguous": float(np.mean([a.ambiguous for a in answers])),
        "poses": float(np.median([a.effort.nodes for a in answers])),
        "tests": float(np.median([a.effort.binary_tests for a in answers])),
    }


def growth(sizes: Iterable[int], rng: np.random.Generator) -> list[Row]:
    """What building, adding feature by feature from none, and memory cost; means have all tables made anew in them."""
    rows = []
    for n in sizes:
        _, landmarks = field(n, rng)
        start = time.thread_time()
        FeatureIndex(landmarks)
        built = time.thread_time() - start
        index, covariance, times = FeatureIndex(reach=11.0, noise=0.07), SIGMA**2 * np.eye(2)[None], []
        for position in landmarks.positions:
            began = time.thread_time_ns()
            index.add(position[None], covariance)
            times.append(1e-3 * (time.thread_time_ns() - began))
        rows.append(
            {
                "n": n,
                "build_us_each": 1e6 * built / n,
                "add_us": float(np.median(times)),
                "add_us_mean": float(np.mean(times)),
                "add_us_mean_last_half": float(np.mean(times[n // 2 :])),
                "longest_add_ms": 1e-3 * max(times),
                "bytes_each": index.nbytes / index.n,
                "triangles_each": index.triangles / index.n,
            }
        )
        print("  ".join(f"{name} {value:.4g}" for name, value in rows[-1].items()), flush=True)
    return rows


def agreement(
    sizes: Iterable[int], queries: int, peers: list[str], clique_limit: float, rng: np.random.Generator
) -> list[Row]:
    """Success and time of the index beside the exact cliques, on the same scans."""
    rows = []
    for n in sizes:
        truth, landmarks = field(n, rng)
        index = FeatureIndex(landmarks)
        for m, spurious, half in [(m, s, h) for m in (10, 20) for s in (0.0, 0.3, 0.5) for h in (False, True)]:
            asked = [query(truth, m, spurious, half, True, rng) for _ in range(queries)]
            row: Row = {"n": n, "m": m, "spurious": spurious, "seen": ("all", "half")[half]}
            row |= beside(index, landmarks, asked, peers, clique_limit)
            rows.append(row)
            _beside_line(row, peers)
    return rows


def beside(index: FeatureIndex, landmarks: Landmarks, asked: list[Query], peers: list[str], clique_limit: float) -> Row:
    """One row of `agreement`. Peers stop taking queries once they have spent `clique_limit` seconds."""
    found = [index.relocate(one.scan) for one in asked]
    times = [milliseconds(lambda one=one: index.relocate(one.scan), 3) for one in asked]  # type: ignore[misc]
    row: Row = {
        "index": float(np.mean([is_right(a.pose, one.pose) for a, one in zip(found, asked)])),
        "accepted": float(np.mean([a.accepted for a in found])),
        "wrong": float(np.mean([a.accepted and not is_right(a.pose, o.pose) for a, o in zip(found, asked)])),
        "ambiguous": float(np.mean([a.ambiguous for a in found])),
        "index_ms": float(np.median(times)),
    }
    graphs: dict[int, tuple[IntArray, float]] = {}
    pairs = pairs_by_length(landmarks)
    for name in peers:
        spent, right, ours, clique, graph = 0.0, [], [], [], []
        for q, one in enumerate(asked):
            if spent > clique_limit:
                break
            if q not in graphs:
                start = time.process_time()
                edges = consistency_edges(one.scan, pairs, len(landmarks))
                graphs[q] = edges, 1e3 * (time.process_time() - start)
            took, vertices = CLIQUES[name](graphs[q][0], len(one.scan) * len(landmarks))
            spent += 1e-3 * took
            pose = locate(one.scan, landmarks, _decisions(vertices, one.scan, landmarks)).pose
            right.append(is_right(pose, one.pose))
            ours.append(is_right(found[q].pose, one.pose))
            clique.append(took)
            graph.append(graphs[q][1])
        row |= {
            f"{name}": float(np.mean(right)),
            f"{name}_scans": len(right),
            f"index_on_those_of_{name}": float(np.mean(ours)),
            f"{name}_ms": float(np.median(clique)),
            "graph_ms": float(np.median(graph)),
            f"{name}_ratio": float(np.median(clique) / row["index_ms"]),
        }
    return row


def _decisions(vertices: list[int], scan: Scan, landmarks: Landmarks) -> IntArray:
    decisions = np.full(len(scan), NONE)
    for v in vertices:
        decisions[v // len(landmarks)] = v % len(landmarks)
    return decisions


# maps from a SLAM run


def after_slam(seeds: int, rng: np.random.Generator) -> list[Row]:
    """Queries in maps that SLAM made: drifted, correlated, anisotropic; the index built at once and grown."""
    rows = []
    for name, maps in (
        ("corridor", _corridors(seeds)),
        ("field, 1 drive", _fields(seeds, rng)),
        ("office, explored", _offices(seeds)),
    ):
        for grown in (False, True):
            right, wrong, ambiguous, times, count = 0, 0, 0, [], 0
            for landmarks, asked in maps:
                index = _grown(landmarks) if grown else FeatureIndex(landmarks)
                for scan, paired in asked:
                    needed = min_pairings(scan, landmarks)
                    answer = index.relocate(scan, landmarks, min_pairings=needed)
                    known = paired != NONE
                    same = np.mean(answer.features[known] == paired[known]) if known.any() else 0.0
                    right += bool(answer.accepted and same >= 0.5)
                    wrong += bool(answer.accepted and same < 0.5)
                    ambiguous += answer.ambiguous
                    times.append(
                        milliseconds(lambda i=index, s=scan, k=needed: i.relocate(s, min_pairings=k), 3)  # type: ignore[misc]
                    )
                    count += 1
            rows.append({"map": name, "index": ("whole", "grown")[grown], "scans": count, "right": right / count})
            rows[-1] |= {"wrong": wrong / count, "ambiguous": ambiguous / count, "ms": float(np.median(times))}
            print("  ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items()))
    return rows


Asked = list[tuple[Scan, IntArray]]


def _grown(landmarks: Landmarks) -> FeatureIndex:
    whole = FeatureIndex(landmarks)
    index = FeatureIndex(reach=whole.reach, noise=0.07)
    for position, covariance in zip(landmarks.positions, relative_covariances(landmarks)):
        index.add(position[None], covariance[None])
    return index


def _fields(seeds: int, rng: np.random.Generator) -> list[tuple[Landmarks, Asked]]:
    """Maps of `bench jcbb`: a drive in lanes over a field of 300 features, with known association."""
    maps = []
    for _ in range(seeds):
        made = jcbb_bench.mapped_field(300, rng)
        asked = []
        for _ in range(10):
            problem = jcbb_bench.problem(made, 14, np.inf, jcbb_bench.CARRIED, rng)
            asked.append((problem.scan, problem.truth))
        maps.append((made.map.landmarks(), asked))
    return maps


def _corridors(seeds: int) -> list[tuple[Landmarks, Asked]]:
    """Maps of the reference corridor by JCBB, and scans of a second walk through it with what they should pair."""
    maps = []
    for seed in range(seeds):
        slam, identities = Slam(SlamSpec(reach=RANGE)), Identities()
        for odometry, scan, truth in walk_round(np.random.default_rng(seed)):
            identities.update(slam.step(odometry, scan), truth)
        known = identities.source_of(slam.map.ids)
        mapped = {int(source): j for j, source in enumerate(known)}
        asked = []
        for step, (_, scan, truth) in enumerate(walk_round(np.random.default_rng(1_000 + seed))):
            if step % 4 == 0:
                asked.append((scan, np.array([mapped.get(int(s), NONE) for s in truth.sources])))
        maps.append((slam.map.landmarks(), asked))
    return maps


def _offices(seeds: int) -> list[tuple[Landmarks, Asked]]:
    """Maps of the scenario office, as an episode driven to the nearest frontiers leaves them, and its last scans."""
    maps = []
    env: Any = gym.make("slam_gym/Explore-v0", scenario="office", action="twist", associator="jcbb").unwrapped
    for seed in range(seeds):
        env.reset(seed=seed)
        pilot, over, step, looks = Pilot(seed), False, 0, []
        while not over:
            _, _, over, _, _ = env.step(pilot.action(env, step))
            looks.append((env.episode.scan, env.episode.truth.sources))
            step += 1
        known = env.episode.identities.source_of(env.episode.slam.map.ids)
        mapped = {int(source): j for j, source in enumerate(known)}
        late = [look for look in looks[len(looks) // 2 :] if len(look[0]) >= 6]
        asked = [(scan, np.array([mapped.get(int(s), NONE) for s in sources])) for scan, sources in late]
        maps.append((env.episode.slam.map.landmarks(), asked[:: max(len(asked) // 15, 1)]))
    return maps


# output


def _line(row: Row) -> None:
    cells = []
    for name, value in row.items():
        if isinstance(value, bool):
            cells.append(f"{'inside' if value else 'outside':7s}" if name == "inside" else str(value))
        elif isinstance(value, float):
            cells.append(f"{name} {value:.3g}")
        else:
            cells.append(f"{name} {value}")
    print("  ".join(cells), flush=True)


def _beside_line(row: Row, peers: list[str]) -> None:
    text = f"n {row['n']:5d}  m {row['m']}  spurious {row['spurious']:.1f}  seen {row['seen']}  index: right "
    text += f"{row['index']:.3f} wrong {row['wrong']:.3f} ambiguous {row['ambiguous']:.3f} {row['index_ms']:.3f} ms"
    for name in peers:
        text += (
            f" | {name}: right {row[name]:.3f} of {row[f'{name}_scans']} (index {row[f'index_on_those_of_{name}']:.3f})"
        )
        text += f" {row[f'{name}_ms']:.3g} ms = {row[f'{name}_ratio']:.3g}×"
    print(text + (f" | graph {row['graph_ms']:.3g} ms" if peers else ""), flush=True)


def _save(folder: Path | None, name: str, rows: list[Row]) -> None:
    if folder is None or not rows:
        return
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / f"associate_{name}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def main(argv: list[str] | None = None) -> None:
    """`python -m slam_gym.bench associate`: print the tables."""
    parser = argparse.ArgumentParser(prog="python -m slam_gym.bench associate", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small maps and few queries: under a minute")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for CSV files")
    arguments = parser.parse_args(argv)
    quick, rng = arguments.quick, np.random.default_rng(arguments.seed)
    sizes = (1_000, 10_000) if quick else (1_000, 10_000, 100_000)
    peers = installed()
    with threadpool_limits(1):
        print(f"seed {arguments.seed}; processor time, medians over queries of the least of 5 [ms]")
        print("\nbuilding, and growing one by one")
        FeatureIndex(field(100, rng)[1])  # compiles, or loads what was compiled
        _save(arguments.out, "growth", growth(sizes, rng))
        print("\nrelocation; right and wrong count accepted answers only")
        _save(arguments.out, "scaling", scaling(sizes, 15 if quick else 40, 5, rng))
        print("\nsuccess (pose within .3 m and 3°, accepted or not) beside exact cliques; ×: clique alone / index")
        _save(
            arguments.out,
            "cliques",
            agreement((100,) if quick else (100, 400, 1_000), 8 if quick else 40, peers, 0.5 if quick else 10.0, rng),
        )
        print("\nmaps from SLAM: right if most pairings are (the corridor's four sides are alike: nothing decides)")
        _save(arguments.out, "slam", after_slam(1 if quick else 5, rng))
        print("\nJCBB at loop closure, 20 measurements × 1 000 features (`bench jcbb` has the rest):")
        loop_closure(40 if quick else 150, rng)


def loop_closure(problems: int, rng: np.random.Generator) -> None:
    """JCBB's time and whole scans right."""
    made = jcbb_bench.mapped_field(1_000, rng)
    rows = []
    for _ in range(problems):
        rows.append(jcbb_bench.measure(jcbb_bench.problem(made, 20, np.inf, jcbb_bench.CARRIED, rng)))
    print(
        f"median {np.median([row['jcbb'] for row in rows]):.0f} µs, whole scans exact "
        f"{np.mean([row['exact'] for row in rows]):.3f}, {np.mean([row['candidates'] for row in rows]):.1f} candidates "
        f"each; targets 150 µs, .90. No package of PyPI with a tree search to be set beside it was found (names with "
        f"JCBB, interpretation tree, data association or relocation); MRPT's JCBB is C++ and was not built."
    )


if __name__ == "__main__":
    main()
