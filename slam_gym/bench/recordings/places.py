"""Real places to be lost in: maps, scans that were not used to make them, and where each scan was really taken.

**Victoria Park.** The first half of the log makes the map, by SLAM with the true association or with JCBB; the robot
is kidnapped at scans of the second half. The reference is the least-squares trajectory of the whole log with the
published identities, moved into the frame of the map by a rigid alignment of the labelled trunks within the laser's
range of the scan, so that the map's own drift is no error. A scan is *inside* if three of its trunks at least are in
the map; *outside* if the labels know the scan, none of its trunks is in the map, and no feature of the map lies
within range ahead of the robot. What is neither is left out. GPS is a second judge, metres coarse.

**MR.CLAM, stationary groups.** The map is surveyed, so that there is no run to tell what is covisible: landmarks are
if one group in every other pose saw both, and the groups of the remaining poses are searched for. Of the groups of a
robot that stands still, one is taken. Groups of another set, whose landmarks stand elsewhere, are *outside*.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from slam_gym.bench.answers import Tolerance
from slam_gym.bench.sensing import features_in_view
from slam_gym.geometry import compose, inverse, transform
from slam_gym.mapping.locality import covisible, linked, same_local_map, within
from slam_gym.metrics.map_quality import align_se2
from slam_gym.recordings.least_squares import Optimum, least_squares
from slam_gym.recordings.mrclam import RelocationCases, stationary
from slam_gym.recordings.recording import Recording
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.scenarios.registry import slam_for
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam
from slam_gym.types import Array, IntArray, Landmarks, Locality, Scan, Truth

Item = TypeVar("Item")

LOCALITIES = ("covisibility", "two hops", "distance", "local maps", "everything")
ROOM_NEAR = Tolerance(1.0, math.radians(15.0))  # of three barcodes a metre apart, known to 15 cm each
SETS = 5
_STOOD_STILL = Tolerance(0.1, math.radians(5.0))
FEATURES_PER_MAP = 30
PARK_NEAR = Tolerance(1.0, math.radians(3.0))  # right answers err by centimetres, wrong ones by tens of metres
MAPPED_BY = {"JCBB": "jcbb", "true association": "true_association"}
"""Associators that make a map, by the names they have in tables."""

_KNOWN = 3  # trunks in the map that a scan from inside has
_MISLABELLED = 5.0  # [m] a feature so far from its label's place was made of something else
_TRIMS = 5  # rounds in which such features are left out of the alignment


@dataclass(frozen=True)
class PlacedScan:
    """A scan, and where it was taken."""

    scan: Scan
    pose: Array  # (3,) in the frame of the map
    inside: bool  # the place is in the map
    gps: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) [m] likewise; NaN where there was no fix


@dataclass(frozen=True, eq=False)
class Place:
    """A map to be lost in."""

    name: str
    landmarks: Landmarks
    localities: Mapping[str, Locality | None]
    scans: Sequence[PlacedScan]
    near: Tolerance  # within which an answer is right


def spread(items: Sequence[Item], count: int) -> list[Item]:
    """At most `count` of the items, evenly spread."""
    if len(items) <= count:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, count).astype(int).tolist()]


@dataclass(frozen=True, eq=False)
class MappedLog:
    """SLAM on a log, and what the labels say of it."""

    slam: Slam
    sources: IntArray  # (n,) identity of each feature of the map: that of the measurement it was made of
    poses: Array  # (T, 3) estimates, step by step


def map_log(log: Recording, associator: str) -> MappedLog:
    """SLAM over a whole log."""
    slam, poses = Slam(slam_for(log)), []
    judged = JudgedSlam(slam, associator)
    for odometry, scan, sources in log.steps():
        judged.step(odometry, scan, Truth(np.zeros(3), sources))
        poses.append(slam.map.pose)
    return MappedLog(slam, judged.identities.source_of(slam.map.ids), np.array(poses))


def reference(log: Recording) -> Optimum:
    """The least-squares optimum of a labelled log, started from the filter with the true association."""
    return least_squares(log, map_log(log, "true_association").poses)


def park(folder: Path, mapped_by: Sequence[str], scans: int, steps: int | None = None) -> list[Place]:
    """Victoria Park mapped in the first half of its (first so many) steps, by some of MAPPED_BY.

    At most so many scans inside and as many outside, evenly spread over the second half. The first map comes with all
    localities, the others with covisibility alone.
    """
    log = victoria_park(folder).part(0, steps)
    optimum, half = reference(log), len(log) // 2
    to_gps = _to_gps(log, optimum.poses)
    places: list[Place] = []
    for name in mapped_by:
        mapped = map_log(log.part(0, half), MAPPED_BY[name])
        found = [_placed_scan(log, k, optimum, mapped, to_gps) for k in range(half, len(log))]
        placed = [scan for scan in found if scan is not None]
        inside, outside = (spread([scan for scan in placed if scan.inside is side], scans) for side in (True, False))
        localities = _localities(mapped.slam, 2.0 * log.range)
        if places:
            localities = {"covisibility": localities["covisibility"]}
        landmarks = mapped.slam.map.landmarks()
        places.append(Place(f"park, map by {name}", landmarks, localities, inside + outside, PARK_NEAR))
    return places


def _localities(slam: Slam, distance: float) -> dict[str, Locality | None]:
    number = np.argsort(np.argsort(slam.map.ids)) // FEATURES_PER_MAP  # as a sequence of local maps would cut them
    return {
        "covisibility": covisible(slam.covisibility),
        "two hops": covisible(slam.covisibility, hops=2),
        "distance": within(slam.map.positions, distance),
        "local maps": same_local_map(number),
        "everything": None,
    }


def _placed_scan(log: Recording, k: int, optimum: Optimum, mapped: MappedLog, to_gps: Array) -> PlacedScan | None:
    """Step k of the log with its place, or None where that is neither inside nor outside."""
    scan, sources = log.scan(k), log.sources_of(k)
    known = int(np.isin(sources[sources >= 0], mapped.sources).sum())
    if len(scan) < _KNOWN or 0 < known < _KNOWN or not (sources >= 0).any():
        return None
    to_map = into_map(optimum, mapped, optimum.poses[k], log.range)
    pose = compose(to_map, optimum.poses[k])
    if known == 0 and len(features_in_view(mapped.slam.map.positions, pose, log.range, math.pi)):
        return None
    fix = gps_at(log, float(log.times[k]))
    return PlacedScan(scan, pose, known > 0, transform(compose(to_map, inverse(to_gps)), fix[None])[0])


def into_map(optimum: Optimum, mapped: MappedLog, pose: Array, reach: float) -> Array:
    """Pose (3,) of the reference frame in that of the map, as the trunks around `pose` have it."""
    place = dict(zip(optimum.ids.tolist(), optimum.landmarks))
    known = np.array([row for row, source in enumerate(mapped.sources.tolist()) if source in place])
    there = np.array([place[source] for source in mapped.sources[known].tolist()])
    here = mapped.slam.map.positions[known]
    kept = np.ones(len(known), bool)
    for _ in range(_TRIMS):
        away = np.hypot(*(transform(align_se2(there[kept], here[kept]), there) - here).T)
        kept = away < max(_MISLABELLED, 2.0 * float(np.median(away)))
    near = kept & (np.hypot(*(there - pose[:2]).T) < reach)
    chosen = near if near.sum() >= 3 else kept
    return align_se2(there[chosen], here[chosen])


def gps_at(log: Recording, time: float, gap: float = 1.0) -> Array:
    """GPS position (2,), interpolated; NaN where a fix before or after is over `gap` [s] away."""
    after = int(np.searchsorted(log.reference_times, time))
    if not 0 < after < len(log.reference_times):
        return np.full(2, np.nan)
    times = log.reference_times[after - 1 : after + 1]
    if time - times[0] > gap or times[1] - time > gap:
        return np.full(2, np.nan)
    return np.array([np.interp(time, times, log.reference_poses[after - 1 : after + 1, i]) for i in (0, 1)])


def _to_gps(log: Recording, poses: Array) -> Array:
    """Pose (3,) of the reference frame in that of the GPS."""
    fixes = np.array([gps_at(log, float(time)) for time in log.times])
    known = np.isfinite(fixes).all(axis=1)
    return align_se2(poses[known, :2], fixes[known])


def room(folder: Path, scans: int) -> list[Place]:
    """The five sets of stationary groups; at most so many scans inside and as many outside, over all of them."""
    sets = [stationary(folder / f"mrclam{number + 1}.mat") for number in range(SETS)]
    distinct = [poses_apart(cases) for cases in sets]
    places = []
    for number, cases in enumerate(sets):
        other = (number + 2) % SETS  # sets 3 and 4 have the same landmarks
        seen, asked = distinct[number][::2], distinct[number][1::2]
        chosen = [_group(cases, k, inside=True) for k in spread(asked, scans // SETS)]
        chosen += [_group(sets[other], k, inside=False) for k in spread(distinct[other], scans // SETS)]
        pairs = {pair for k in seen for pair in itertools.combinations(sorted(set(cases.features_of(k).tolist())), 2)}
        links, count = np.array(sorted(pairs), np.int64).reshape(-1, 2), len(cases.landmarks)
        localities = {"covisibility": linked(count, links), "two hops": linked(count, links, 2), "everything": None}
        places.append(Place("room, surveyed", cases.map(), localities, chosen, ROOM_NEAR))
    return places


def _group(cases: RelocationCases, case: int, *, inside: bool) -> PlacedScan:
    return PlacedScan(cases.scan(case), cases.poses[case], inside)


def poses_apart(cases: RelocationCases) -> list[int]:
    """Cases whose robot has moved since the one before in the list."""
    kept: list[int] = []
    for case, pose in enumerate(cases.poses):
        if not kept or not _STOOD_STILL.holds(pose, cases.poses[kept[-1]]):
            kept.append(case)
    return kept
