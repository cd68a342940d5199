"""Relocation on real data: right, wrong and no answer, by the number of pairings that is asked for.

Victoria Park and the stationary groups of MR.CLAM, as `places` makes maps and scans of them. Each scan is searched for
by GCBB, by random sampling (RS) and by the feature index, under each
locality, with and without the trunk diameters that the laser measured. An answer with at least k pairings counts as
given; under *rule* the search's own acceptance decides. Inside the map an answer is right within 1 m and 3° (room:
15°) of the reference; outside, every answer is wrong. Intervals are 95 %, those of no event one-sided; scans of one
log are not independent, so that they are narrower than they should be.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from slam_gym.association.relocation.acceptance import min_pairings
from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.association.relocation.random_sampling import random_sampling
from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.bench.answers import ACCEPTED, attempt, count_answers, without_sizes
from slam_gym.bench.recordings.places import Place, PlacedScan, park, room
from slam_gym.bench.records import Record, column, grouped, medians
from slam_gym.bench.report import Report
from slam_gym.bench.runner import UsageError, data_folder
from slam_gym.geometry import wrap_angle
from slam_gym.types import Landmarks, Locality, Relocation, Relocator, Scan

ASKED = (ACCEPTED, *range(3, 10))
"""Numbers of pairings asked for."""

_JUDGED_UNDER = "covisibility"
_MANY = 6  # pairings, from which hardly anything is wrong


class Workload(NamedTuple):
    """How much is run."""

    scans: int  # inside, and as many outside, of each map of the park
    groups: int  # of MR.CLAM, likewise, over the five sets
    node_limit: int
    mapped_by: tuple[str, ...] = ("JCBB", "true association")  # maps after the first: covisibility only


FULL = Workload(120, 1000, 20_000)
QUICK = Workload(20, 100, 5_000, ("JCBB",))


def attempts(places: Iterable[Place], node_limit: int) -> list[Record]:
    """Every search under every locality on every scan, with sizes and without."""
    records = []
    for place in places:
        known = bool(np.isfinite(place.landmarks.sizes).any())
        for sizes in (True, False) if known else (False,):
            landmarks = place.landmarks if sizes else without_sizes(place.landmarks)
            for name, search in searches(landmarks, node_limit).items():
                for locality, local in place.localities.items():
                    key = {"place": place.name, "search": name, "sizes": "used" if sizes else "unknown"}
                    for placed in place.scans:
                        scan = placed.scan if sizes else without_sizes(placed.scan)
                        answer, record = attempt(search, scan, landmarks, local)
                        records.append({**key, "locality": locality, **record, **judged(place, placed, answer)})
    return records


def judged(place: Place, placed: PlacedScan, answer: Relocation) -> Record:
    """How far an answer is off, from the reference and from the GPS; NaN without an answer or a fix."""
    off = answer.pose - placed.pose
    return {
        "inside": placed.inside,
        "right": placed.inside and place.near.holds(answer.pose, placed.pose),
        "metres": float(np.hypot(*off[:2])),
        "degrees": abs(math.degrees(wrap_angle(float(off[2])))),
        "metres from GPS": float(np.hypot(*(answer.pose[:2] - placed.gps))),
    }


def searches(landmarks: Landmarks, node_limit: int) -> dict[str, Relocator]:
    """The searches by name, for one map: the index is built once, and each is called once so that it is compiled."""
    index = FeatureIndex(landmarks)

    def indexed(scan: Scan, landmarks: Landmarks, locality: Locality | None) -> Relocation:
        asked = min_pairings(scan, landmarks)
        return index.relocate(scan, landmarks, locality, min_pairings=asked, node_limit=node_limit)

    table: dict[str, Relocator] = {
        "gcbb": functools.partial(gcbb, node_limit=node_limit),
        "random_sampling": functools.partial(random_sampling, node_limit=node_limit),
        "indexed": indexed,
    }
    few = slice(0, 3)
    noise, sigma = landmarks.covariances[few] + 0.01 * np.eye(2), np.sqrt(landmarks.size_variances[few])
    scan = Scan.from_points(landmarks.positions[few], noise, sizes=landmarks.sizes[few], size_sigma=sigma)
    for search in table.values():
        search(scan, landmarks, None)
    return table


def answers_table(records: Sequence[Record]) -> list[Record]:
    """Right, wrong and none by search, sizes and k."""
    groups = grouped([r for r in records if r["locality"] == _JUDGED_UNDER], "place", "sizes", "search")
    return [key | count_answers(group, asked) for key, group in groups for asked in ASKED]


def localities_table(records: Sequence[Record]) -> list[Record]:
    """The same under each locality, for the rule and for six; nodes and time inside and outside."""
    rows = []
    for key, group in grouped(records, "place", "sizes", "search", "locality"):
        row = key
        for name, asked in (("rule", ACCEPTED), ("six", _MANY)):
            counts = count_answers(group, asked)
            row |= {f"{name}: {heading}": counts[heading] for heading in ("right", "wrong", "outside: wrong")}
        row |= medians(group, "nodes")
        for inside, heading in ((True, "ms inside, median / 95 %"), (False, "ms outside")):
            row[heading] = _percentiles([r for r in group if r["inside"] is inside], "ms", 50, 95)
        rows.append(row | {"limit hit": sum(r["limit hit"] for r in group)})
    return rows


def apart_table(records: Sequence[Record]) -> list[Record]:
    """Distances from the reference and from the GPS, which show how little the tolerance decides."""
    rows = []
    for key, group in grouped([r for r in records if r["inside"] and r["pairings"] >= _MANY], "place"):
        for right in (True, False):
            chosen = [r for r in group if r["right"] is right]
            row = {**key, "answers": "right" if right else "wrong", "number": len(chosen)}
            row["m from the reference, 0 / 5 / 50 / 95 / 100 %"] = _percentiles(chosen, "metres", 0, 5, 50, 95, 100)
            rows.append(row | {"m from the GPS": _percentiles(chosen, "metres from GPS", 0, 5, 50, 95, 100)})
    return rows


def _percentiles(records: Sequence[Record], name: str, *wanted: int) -> str:
    known = column(records, name)
    known = known[np.isfinite(known)]
    return " / ".join(f"{v:.2f}" for v in np.percentile(known, wanted)) if len(known) else ""


def run(
    report: Report, *, data: Path | None = None, only: Literal["room", "park"] | None = None, quick: bool = False
) -> None:
    """Three tables, and every attempt in a CSV file.

    Arguments:
        data: folder of the recordings (default: environment SLAM_GYM_DATA)
        only: one of the two places
        quick: fewer scans, one map of the park: under a minute
    """
    folder, w = data_folder(data), QUICK if quick else FULL
    if folder is None:
        raise UsageError("no data: name their folder with --data or SLAM_GYM_DATA (victoria_park/, mrclam/stationary/)")
    makers: dict[str, Callable[[], list[Place]]] = {
        "room": lambda: room(folder / "mrclam" / "stationary", w.groups),
        "park": lambda: park(folder / "victoria_park", w.mapped_by, w.scans),
    }
    records = []
    for name, make in makers.items():
        if only in (None, name):
            with report.part(name):
                records += attempts(make(), w.node_limit)
    counts = answers_table(records)
    report.table(f"Answers by the number of pairings asked for, {_JUDGED_UNDER}", counts)
    report.table("Localities: answers under the rule and from six pairings, effort", localities_table(records))
    report.table("How far right and wrong answers of six pairings or more lie apart", apart_table(records))
    report.rows("relocations", records)
