"""Real places to be lost in: maps, scans that were not used to make them, and where each scan was really taken.

**Victoria Park.** The first half of the log makes the map, by SLAM with the true association or with JCBB; the robot is
kidnapped at scans of the second half. The reference is the least-squares trajectory of the whole log with the published
identities, moved into the frame of the map by a rigid alignment of the labelled trunks within the laser's range of the
scan, so that the map's own drift is no error. A scan is *inside* if three of its trunks at least are in the map;
*outside* if the labels know the scan, none of its trunks is in the map, and no feature of the map lies within range
ahead of the robot. What is neither is left out. GPS is a second judge, metres coarse.

**MR.CLAM, stationary groups.** The map is surveyed, so that there is no run to tell what is covisible: landmarks are if
one group in every other pose saw both, and the groups of the remaining poses are searched for. Of the groups of a
robot that stands still, one is taken. Groups of another set, whose landmarks stand elsewhere, are *outside*.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from slam_gym.geometry import compose, inverse, observe, transform, wrap_angle
from slam_gym.mapping.locality import covisible, linked, same_local_map, within
from slam_gym.metrics.map_quality import align_se2
from slam_gym.recordings.least_squares import Optimum, least_squares
from slam_gym.recordings.mrclam_groups import stationary
from slam_gym.recordings.recording import Recording
from slam_gym.recordings.relocation_cases import RelocationCases
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.scenarios.recorded import slam_for
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam
from slam_gym.types import Array, IntArray, Landmarks, Locality, Scan, Truth

_Item = TypeVar("_Item")

LOCALITIES = ("covisibility", "two hops", "distance", "local maps", "everything")
FEATURES_PER_MAP = 30
PARK_NEAR = (1.0, math.radians(3.0))  # [m, rad] right answers err by centimetres, wrong ones by tens of metres
ROOM_NEAR = (1.0, math.radians(15.0))  # of three barcodes a metre apart, known to 15 cm each
_MISLABELLED = 5.0  # [m] a feature so far from its label's place was made of something else
_TRIMS = 5  # rounds in which such features are left out of the alignment
_STOOD_STILL = (0.1, math.radians(5.0))  # [m, rad]


@dataclass(frozen=True)
class Look:
    """A scan, and where it was taken."""

    scan: Scan
    pose: Array  # (3,) in the frame of the map
    inside: bool
    gps: Array  # (2,) [m] in the frame of the map; NaN where there was no fix


@dataclass(frozen=True, eq=False)
class Place:
    """A map to be lost in."""

    name: str
    landmarks: Landmarks
    localities: dict[str, Locality | None]
    looks: list[Look]
    near: tuple[float, float]  # [m, rad] within which an answer is right


@dataclass(frozen=True, eq=False)
class Run:
    """SLAM on a log, and what the labels say of it."""

    slam: Slam
    sources: IntArray  # (n,) identity of each feature of the map: that of the measurement it was made of
    poses: Array  # (T, 3) estimates, step by step


def run_slam(log: Recording, true: bool) -> Run:
    """A whole log with the true association, or with JCBB."""
    slam, poses = Slam(slam_for(log)), []
    judged = JudgedSlam(slam, "true_association" if true else "jcbb")
    for odometry, scan, sources in log.steps():
        judged.step(odometry, scan, Truth(np.zeros(3), sources))
        poses.append(slam.map.pose)
    return Run(slam, judged.identities.source_of(slam.map.ids), np.array(poses))


def reference(log: Recording) -> Optimum:
    """The least-squares optimum of a labelled log, started from the filter with the true association."""
    return least_squares(log, run_slam(log, true=True).poses)


def park(folder: Path, associations: tuple[str, ...], scans: int, steps: int | None = None) -> list[Place]:
    """Victoria Park mapped in the first half of its (first so many) steps, by "true association" or "JCBB".

    At most so many scans inside and as many outside, evenly spread over the second half. The first map comes with all
    localities, the others with covisibility alone.
    """
    log = victoria_park(folder).part(0, steps)
    optimum, half = reference(log), len(log) // 2
    to_gps = _to_gps(log, optimum.poses)
    places: list[Place] = []
    for name in associations:
        run = run_slam(log.part(0, half), name == "true association")
        looks = [_look(log, k, optimum, run, to_gps) for k in range(half, len(log))]
        chosen = [
            spread([look for look in looks if look is not None and look.inside is inside], scans)
            for inside in (True, False)
        ]
        localities = _localities(run.slam, 2.0 * log.range)
        if places:
            localities = {"covisibility": localities["covisibility"]}
        landmarks = run.slam.map.landmarks()
        places.append(Place(f"park, map by {name}", landmarks, localities, chosen[0] + chosen[1], PARK_NEAR))
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


def _look(log: Recording, k: int, optimum: Optimum, run: Run, to_gps: Array) -> Look | None:
    """Step k of the log as a look, or None where it is neither inside nor outside."""
    scan, sources = log.scan(k), log.sources_of(k)
    common = int(np.isin(sources[sources >= 0], run.sources).sum())
    if len(scan) < 3 or 0 < common < 3 or not (sources >= 0).any():
        return None
    to_map = into_map(optimum, run, optimum.poses[k], log.range)
    pose = compose(to_map, optimum.poses[k])
    seen = observe(pose, run.slam.map.positions)
    if common == 0 and ((np.hypot(*seen.T) < log.range) & (seen[:, 0] > 0.0)).any():
        return None
    fix = gps_at(log, float(log.times[k]))
    return Look(scan, pose, common > 0, transform(compose(to_map, inverse(to_gps)), fix[None])[0])


def into_map(optimum: Optimum, run: Run, pose: Array, reach: float) -> Array:
    """Pose (3,) of the reference frame in that of the map, as the trunks around `pose` have it."""
    place = dict(zip(optimum.ids.tolist(), optimum.landmarks))
    known = np.array([row for row, source in enumerate(run.sources.tolist()) if source in place])
    there = np.array([place[source] for source in run.sources[known].tolist()])
    here = run.slam.map.positions[known]
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
    sets = [stationary(folder / f"mrclam{number}.mat") for number in range(1, 6)]
    distinct = [poses_apart(cases) for cases in sets]
    places = []
    for number, cases in enumerate(sets):
        other = (number + 2) % len(sets)  # sets 3 and 4 have the same landmarks
        seen, asked = distinct[number][::2], distinct[number][1::2]
        looks = [_group(cases, k, True) for k in spread(asked, scans // len(sets))]
        looks += [_group(sets[other], k, False) for k in spread(distinct[other], scans // len(sets))]
        pairs = {pair for k in seen for pair in itertools.combinations(sorted(set(cases.features_of(k).tolist())), 2)}
        graph = np.array(sorted(pairs), np.int64).reshape(-1, 2)
        count = len(cases.landmarks)
        localities = {"covisibility": linked(count, graph), "two hops": linked(count, graph, 2), "everything": None}
        places.append(Place("room, surveyed", cases.map(), localities, looks, ROOM_NEAR))
    return places


def _group(cases: RelocationCases, case: int, inside: bool) -> Look:
    return Look(cases.scan(case), cases.poses[case], inside, np.full(2, np.nan))


def poses_apart(cases: RelocationCases) -> list[int]:
    """Cases whose robot has moved since the one before in the list."""
    kept: list[int] = []
    for case, pose in enumerate(cases.poses):
        if kept:
            moved = pose - cases.poses[kept[-1]]
            if np.hypot(*moved[:2]) < _STOOD_STILL[0] and abs(wrap_angle(moved[2])) < _STOOD_STILL[1]:
                continue
        kept.append(case)
    return kept


def spread(items: list[_Item], count: int) -> list[_Item]:
    """At most `count` of the items, evenly spread."""
    if len(items) <= count:
        return items
    return [items[i] for i in np.linspace(0, len(items) - 1, count).astype(int).tolist()]
