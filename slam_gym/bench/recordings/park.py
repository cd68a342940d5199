"""Victoria Park as a place to be lost in.

The first half of the log makes the map, by SLAM with the true association or with JCBB; the robot is kidnapped at scans
of the second half. The reference is the least-squares trajectory of the whole log with the published identities, moved
into the frame of the map by a rigid alignment of the labelled trunks within the laser's range of the scan, so that the
map's own drift is no error. A scan is *inside* if three of its trunks at least are in the map; *outside* if the labels
know the scan, none of its trunks is in the map, and no feature of the map lies within range ahead of the robot. What is
neither is left out. GPS is a second judge, metres coarse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam_gym.bench.answers import Tolerance
from slam_gym.bench.recordings.places import Place, PlacedScan, spread
from slam_gym.bench.sensing import features_in_view
from slam_gym.geometry import compose, inverse, transform
from slam_gym.mapping.locality import covisible, same_local_map, within
from slam_gym.metrics.map_quality import align_se2
from slam_gym.recordings.least_squares import Optimum, least_squares
from slam_gym.recordings.recording import Recording
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.scenarios.recorded import slam_for
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam
from slam_gym.types import Array, IntArray, Locality, Truth

FEATURES_PER_MAP = 30
NEAR = Tolerance(1.0, math.radians(3.0))  # right answers err by centimetres, wrong ones by tens of metres
MAPPED_BY = {"JCBB": "jcbb", "true association": "true_association"}
"""Associators that make a map, by the names they have in tables."""

_KNOWN = 3  # trunks in the map that a scan from inside has
_MISLABELLED = 5.0  # [m] a feature so far from its label's place was made of something else
_TRIMS = 5  # rounds in which such features are left out of the alignment


@dataclass(frozen=True, eq=False)
class MappedLog:
    """SLAM on a log, and what the labels say of it."""

    slam: Slam
    sources: IntArray  # (n,) identity of each feature of the map: that of the measurement it was made of
    poses: Array  # (T, 3) estimates, step by step


def map_log(log: Recording, associator: str) -> MappedLog:
    """SLAM over a whole log."""
    judged, poses = JudgedSlam(Slam(slam_for(log)), associator), []
    for odometry, scan, sources in log.steps():
        judged.step(odometry, scan, Truth(np.zeros(3), sources))
        poses.append(judged.slam.map.pose)
    return MappedLog(judged.slam, judged.identities.source_of(judged.slam.map.ids), np.array(poses))


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
        places.append(Place(f"park, map by {name}", landmarks, localities, inside + outside, NEAR))
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
