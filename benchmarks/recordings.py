"""Relocation on Victoria Park: right, wrong and no answers, inside and outside the map.

The map is made from the first half of the log, by SLAM with JCBB; the robot is kidnapped at scans of the second half.
The reference is the least-squares trajectory of the whole log with the published identities, moved to the frame of the
map by a rigid alignment of the labelled trunks within the laser's range of the scan, so that the map's drift is no
error. A scan is *inside* if at least three of its trunks are in the map; *outside* if it has labels, none of its trunks
is in the map, and no feature of the map lies within range ahead. Other scans are left out.

The searches are GCBB, random sampling and the feature index (built for each scan), with the measured trunk diameters
and without. A pose is right within 1 m and 3°. Intervals are 95 %; they are too narrow, since scans of one log are not
independent.

    SLAM_GYM_DATA=... python benchmarks/recordings.py       # five minutes
"""

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from agents.evaluation.mapped_log import MappedLog, map_log
from benchmarks.common import attempt, count_answers, options, published, table
from slam_gym import Landmarks, Locality, Scan, Smoothed, gcbb, indexed, random_sampling, smooth
from slam_gym.geometry import compose, transform
from slam_gym.mapping.locality import covisible, within
from slam_gym.metrics.map_quality import align_se2
from slam_gym.recordings.recording import Recording
from slam_gym.scenarios import slam_for
from slam_gym.simulation.judged import CEILING
from slam_gym.simulation.kidnapping import is_right
from slam_gym.simulation.surveyed_field import features_in_view
from slam_gym.types import Array

KNOWN = 3  # least number of mapped trunks in a scan from inside
MISLABELLED = 5.0  # [m] a feature this far from the place of its label has another source
NEAR = 1.0, math.radians(3.0)  # errors are centimetres for right answers, tens of metres for wrong ones

PlacedScan = tuple[Scan, Array, bool]
"""A scan, its pose (3,) in the frame of the map, and whether it is from inside the map."""


def reference(log: Recording) -> Smoothed:
    """The least-squares optimum of a labelled log, started at the filter with true association."""
    return smooth(*zip(*log.steps()), initial=map_log(log, CEILING, slam_for(log)).poses)


def park(log: Recording, scans: int) -> tuple[Landmarks, dict[str, Locality | None], list[PlacedScan]]:
    """The map of the first half of a log, its localities by name, and scans of the second half to relocate in it: up to
    `scans` inside, as many outside."""
    optimum, half = reference(log), len(log) // 2
    mapped = map_log(log.part(0, half), "jcbb", slam_for(log))
    slam = mapped.slam
    placed = [one for k in range(half, len(log)) if (one := placed_scan(log, k, optimum, mapped)) is not None]
    chosen: list[PlacedScan] = []
    for side in (True, False):
        known = [one for one in placed if one[2] is side]
        chosen += [known[i] for i in np.linspace(0, len(known) - 1, min(scans, len(known))).astype(int).tolist()]
    localities: dict[str, Locality | None] = {
        "covisibility": covisible(slam.covisibility),
        "two hops": covisible(slam.covisibility, hops=2),
        "distance": within(slam.map.positions, 2.0 * log.range),
        "everything": None,
    }
    return slam.map.landmarks(), localities, chosen


def placed_scan(log: Recording, k: int, optimum: Smoothed, mapped: MappedLog) -> PlacedScan | None:
    """The scan of step k with its pose, or None where it is neither inside nor outside."""
    scan, sources = log.scan(k), log.sources_of(k)
    known = int(np.isin(sources[sources >= 0], mapped.features["identity"]).sum())
    if len(scan) < KNOWN or 0 < known < KNOWN or not (sources >= 0).any():
        return None
    pose = compose(into_map(optimum, mapped, optimum.poses[k], log.range), optimum.poses[k])
    if known == 0 and len(features_in_view(mapped.slam.map.positions, pose, log.range, math.pi)):
        return None
    return scan, pose, known > 0


def into_map(optimum: Smoothed, mapped: MappedLog, pose: Array, reach: float) -> Array:
    """The pose (3,) of the reference frame in the frame of the map, by alignment of the trunks around `pose`."""
    identities = mapped.features["identity"].to_numpy()
    known = np.isin(identities, optimum.ids)
    there = optimum.positions[np.searchsorted(optimum.ids, identities[known])]
    here, inliers = mapped.slam.map.positions[known], np.ones(len(there), bool)
    for _ in range(5):
        errors = np.hypot(*(transform(align_se2(there[inliers], here[inliers]), there) - here).T)
        inliers = errors < max(MISLABELLED, 2.0 * float(np.median(errors)))
    near = inliers & (np.hypot(*(there - pose[:2]).T) < reach)
    chosen = near if near.sum() >= 3 else inliers
    return align_se2(there[chosen], here[chosen])


def without_sizes(sized: Any) -> Any:
    """The same scan or map with all sizes unknown."""
    unknown = np.full(len(sized), math.nan)
    return replace(sized, sizes=unknown, size_variances=unknown.copy())


def attempts(
    landmarks: Landmarks, localities: Mapping[str, Locality | None], scans: Sequence[PlacedScan], node_limit: int
) -> pd.DataFrame:
    """The results of every search under every locality on every scan, with sizes and without."""
    rows = []
    for sizes, search, locality in itertools.product((True, False), (gcbb, random_sampling, indexed), localities):
        limited = functools.partial(search, node_limit=node_limit)
        shown = landmarks if sizes else without_sizes(landmarks)
        for scan, pose, inside in scans:
            answer, record = attempt(limited, scan if sizes else without_sizes(scan), shown, localities[locality])
            key = {"sizes": sizes, "search": search.__name__, "locality": locality, "inside": inside}
            rows.append(key | record | {"right": inside and is_right(answer.pose, pose, *NEAR)})
    return pd.DataFrame(rows)


if __name__ == "__main__":
    a = options(__doc__, scans=120)
    log = published("victoria_park")
    if log is None:
        raise SystemExit
    scans, limit, steps = (3, 2000, 1200) if a.quick else (a.scans, 20_000, None)
    results = attempts(*park(log.part(0, steps), scans), limit)
    rows, keys = [], ["sizes", "search"]
    for key, group in results[results["locality"] == "covisibility"].groupby(keys, sort=False):
        rows += [dict(zip(keys, key)) | count_answers(group, least) for least in (None, *range(3, 10))]
    table("Answers by the required number of pairings, covisibility", rows)
    rows, keys = [], [*keys, "locality"]
    for key, group in results.groupby(keys, sort=False):
        row = dict(zip(keys, key)) | count_answers(group, None)
        rows.append(row | group[["nodes", "ms"]].median().to_dict() | {"limit hit": group["limit hit"].sum()})
    table("Localities under the rule, and effort", rows)
