"""The stationary groups of MR.CLAM as places to be lost in.

The map is surveyed, so that there is no run to tell what is covisible: landmarks are if one group in every other pose
saw both, and the groups of the remaining poses are searched for. Of the groups of a robot that stands still, one is
taken. Groups of another set, whose landmarks stand elsewhere, are *outside*.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np

from slam_gym.bench.answers import Tolerance
from slam_gym.bench.recordings.places import Place, PlacedScan, spread
from slam_gym.mapping.locality import linked
from slam_gym.recordings.mrclam import stationary
from slam_gym.recordings.relocation_cases import RelocationCases

NEAR = Tolerance(1.0, math.radians(15.0))  # of three barcodes a metre apart, known to 15 cm each
SETS = 5
_STOOD_STILL = Tolerance(0.1, math.radians(5.0))


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
        places.append(Place("room, surveyed", cases.map(), localities, chosen, NEAR))
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
