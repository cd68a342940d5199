"""Relocation by the feature index in maps that SLAM made: drifted, correlated, anisotropic."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from slam_gym.association.relocation.acceptance import min_pairings
from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.association.triangles.map import relative_covariances
from slam_gym.bench.exploration import explore, explorer
from slam_gym.bench.records import Record, means, medians
from slam_gym.bench.speed.loop_closure import CARRIED, closure_scan, mapped_field
from slam_gym.bench.timing import THREAD, fastest
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import UNPAIRED, IntArray, Landmarks, Relocation, Scan
from slam_gym.world.corridor import RANGE, walk_round

_NOISE = 0.07  # [m] of an index that grows


class KnownScan(NamedTuple):
    """A scan, and what it should be paired with."""

    scan: Scan
    truth: IntArray  # (m,) landmark behind each measurement, UNPAIRED where there is none


class SlamMap(NamedTuple):
    """A map, and scans to be relocated in it."""

    landmarks: Landmarks
    scans: list[KnownScan]


def after_slam(seeds: int, rng: np.random.Generator) -> list[Record]:
    """The index built at once, and grown feature by feature."""
    made = {"corridor": corridors(seeds), "field, 1 drive": fields(seeds, rng), "office, explored": offices(seeds)}
    return [
        {"map": name, "index": index, **relocate_all(maps, make)}
        for name, maps in made.items()
        for index, make in (("whole", FeatureIndex), ("grown", grown_index))
    ]


def relocate_all(maps: Sequence[SlamMap], make: Callable[[Landmarks], FeatureIndex]) -> Record:
    """Every scan in its map: `right` where most pairings are."""
    records = []
    for landmarks, scans in maps:
        index = make(landmarks)
        for scan, truth in scans:
            needed = min_pairings(scan, landmarks)
            answer = index.relocate(scan, landmarks, min_pairings=needed)
            right = mostly_right(answer, truth)
            again = partial(index.relocate, scan, min_pairings=needed)
            took = {"ambiguous": answer.ambiguous, "ms": 1e-3 * fastest(again, repeats=3, clock=THREAD)}
            records.append(took | {"right": answer.accepted and right, "wrong": answer.accepted and not right})
    return {"scans": len(records), **means(records, "right", "wrong", "ambiguous"), **medians(records, "ms")}


def mostly_right(answer: Relocation, truth: IntArray) -> bool:
    """Whether half the measurements of landmarks, at least, are paired with theirs."""
    known = truth != UNPAIRED
    return bool(known.any() and np.mean(answer.features[known] == truth[known]) >= 0.5)


def grown_index(landmarks: Landmarks) -> FeatureIndex:
    """Made by adding one feature after the other."""
    index = FeatureIndex(reach=FeatureIndex(landmarks).reach, noise=_NOISE)
    for position, covariance in zip(landmarks.positions, relative_covariances(landmarks)):
        index.add(position[None], covariance[None])
    return index


def fields(seeds: int, rng: np.random.Generator) -> list[SlamMap]:
    """A drive in lanes over a field of 300 features, with known association."""
    maps = []
    for _ in range(seeds):
        made = mapped_field(300, rng)
        drawn = [closure_scan(made, 14, CARRIED, rng) for _ in range(10)]
        maps.append(SlamMap(made.map.landmarks(), [KnownScan(one.scan, one.truth) for one in drawn]))
    return maps


def corridors(seeds: int) -> list[SlamMap]:
    """The reference corridor mapped by JCBB, and scans of a second walk through it."""
    maps = []
    for seed in range(seeds):
        slam = Slam(SlamSpec(reach=RANGE))
        judged = JudgedSlam(slam, "jcbb")
        for odometry, scan, truth in walk_round(np.random.default_rng(seed)):
            judged.step(odometry, scan, truth)
        identities = judged.identities.source_of(slam.map.ids)
        second = list(walk_round(np.random.default_rng(1_000 + seed)))[::4]
        scans = [KnownScan(scan, in_map(truth.sources, identities)) for _, scan, truth in second]
        maps.append(SlamMap(slam.map.landmarks(), scans))
    return maps


def offices(seeds: int) -> list[SlamMap]:
    """The scenario office, as an episode driven to the nearest frontiers leaves it, and its last scans."""
    maps, env = [], explorer("office", associator="jcbb")
    for seed in range(seeds):
        seen = [(env.episode.scan, env.episode.truth.sources) for _ in explore(env, seed)]
        identities = env.episode.identities.source_of(env.episode.slam.map.ids)
        late = [(scan, sources) for scan, sources in seen[len(seen) // 2 :] if len(scan) >= 6]
        scans = [KnownScan(scan, in_map(sources, identities)) for scan, sources in late]
        maps.append(SlamMap(env.episode.slam.map.landmarks(), scans[:: max(len(scans) // 15, 1)]))
    return maps


def in_map(sources: IntArray, identities: IntArray) -> IntArray:
    """(m,) landmark of each source, the newest of several; UNPAIRED where there is none."""
    landmark_of = {source: j for j, source in enumerate(identities.tolist()) if source >= 0}
    return np.array([landmark_of.get(int(source), UNPAIRED) for source in sources], np.int64)
