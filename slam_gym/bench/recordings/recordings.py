"""Relocation on real data: right, wrong and no answer, by the least number of pairings that is believed.

Victoria Park and the stationary groups of MR.CLAM, as `recordings_places` makes maps and scans of them. Each scan is
searched for by GCBB, by random sampling (RS) and by the feature index, under each locality, with and without the
trunk diameters that the laser measured. An answer with at least k pairings counts as given; under *rule* the search's
own acceptance decides. Inside the map an answer is right within 1 m and 3° (room: 15°) of the reference; outside, every
answer is wrong. Intervals are 95 %, those of no event one-sided; scans of one log are not independent, so that they
are narrower than they should be.
"""

from __future__ import annotations

import argparse
import csv
import functools
import math
import os
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from slam_gym.association.relocation.acceptance import min_pairings
from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.association.relocation.random_sampling import random_sampling
from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.bench.locality.acceptance import RULE, Outcome, text
from slam_gym.bench.locality.tables import Table, show
from slam_gym.bench.recordings.places import LOCALITIES, Look, Place, park, room
from slam_gym.geometry import wrap_angle
from slam_gym.types import Landmarks, Locality, Relocation, Scan

LEAST = (RULE, *range(3, 10))
SEARCHES = ("gcbb", "rs", "indexed")
_JUDGED = "covisibility"

_Sized = TypeVar("_Sized", Scan, Landmarks)

Search = Callable[[Scan, Locality | None], Relocation]


@dataclass(frozen=True)
class Setting:
    """How much is run."""

    scans: int  # inside, and as many outside, of each map of the park
    groups: int  # of MR.CLAM, likewise, over the five sets
    node_limit: int
    associations: tuple[str, ...] = ("JCBB", "true association")  # maps after the first: covisibility only


FULL = Setting(120, 1000, 20_000)
QUICK = Setting(20, 100, 5_000, ("JCBB",))


@dataclass(frozen=True)
class Attempt:
    """One scan searched for."""

    place: str
    search: str
    locality: str
    sizes: bool  # trunk diameters were used
    inside: bool
    measurements: int
    pairings: int
    asked: int  # by the acceptance rule
    ambiguous: bool
    accepted: bool
    right: bool
    metres: float  # from the reference; NaN without an answer
    degrees: float
    metres_gps: float  # from the GPS; NaN where there was no fix
    nodes: int
    limit_hit: bool
    milliseconds: float

    def answers(self, least: int) -> bool:
        """Whether this counts as an answer when so many pairings are asked for, or under RULE."""
        return self.accepted if least == RULE else self.pairings >= least


def attempts(places: Iterable[Place], setting: Setting) -> list[Attempt]:
    """Every search under every locality on every look, with sizes and without."""
    found = []
    for place in places:
        known = bool(np.isfinite(place.landmarks.sizes).any())
        for sizes in (True, False) if known else (False,):
            landmarks = place.landmarks if sizes else without_sizes(place.landmarks)
            for name, search in searches(landmarks, setting.node_limit).items():
                for locality, local in place.localities.items():
                    for look in place.looks:
                        scan = look.scan if sizes else without_sizes(look.scan)
                        start = time.perf_counter()
                        answer = search(scan, local)
                        seconds = time.perf_counter() - start
                        found.append(_judged(place, name, locality, sizes, look, answer, seconds))
    return found


def searches(landmarks: Landmarks, node_limit: int) -> dict[str, Search]:
    """The searches by name, in one map; the index is built once, and each is called once so that it is compiled."""
    index = FeatureIndex(landmarks)

    def one(search: Callable[..., Relocation]) -> Search:
        return lambda scan, locality: search(scan, landmarks, locality, node_limit=node_limit)

    def indexed(scan: Scan, locality: Locality | None) -> Relocation:
        asked = min_pairings(scan, landmarks)
        return index.relocate(scan, landmarks, locality, min_pairings=asked, node_limit=node_limit)

    table = {"gcbb": one(gcbb), "rs": one(random_sampling), "indexed": indexed}
    few = np.arange(min(3, len(landmarks)))
    scan = Scan(
        landmarks.positions[few],
        landmarks.covariances[few] + 0.01 * np.eye(2),
        landmarks.sizes[few],
        landmarks.size_variances[few],
    )
    for search in table.values():
        search(scan, None)
    return table


def without_sizes(given: _Sized) -> _Sized:
    """The same with all sizes unknown."""
    unknown = np.full(len(given), math.nan)
    return replace(given, sizes=unknown, size_variances=unknown.copy())


def _judged(
    place: Place, search: str, locality: str, sizes: bool, look: Look, answer: Relocation, seconds: float
) -> Attempt:
    off = answer.pose - look.pose
    metres, degrees = float(np.hypot(*off[:2])), abs(math.degrees(wrap_angle(float(off[2]))))
    right = metres < place.near[0] and math.radians(degrees) < place.near[1]
    return Attempt(
        place.name,
        search,
        locality,
        sizes,
        look.inside,
        len(look.scan),
        answer.pairings,
        answer.min_pairings,
        answer.ambiguous,
        answer.accepted,
        right and look.inside,
        metres,
        degrees,
        float(np.hypot(*(answer.pose[:2] - look.gps))),
        answer.effort.nodes,
        answer.effort.limit_hit,
        1e3 * seconds,
    )


def outcome(rows: Iterable[Attempt], least: int) -> Outcome:
    """What came of the scans when `least` pairings are asked for (RULE: when the search is believed)."""
    count = dict.fromkeys(("right", "wrong", "silent", "stray", "quiet", "alone"), 0)
    for row in rows:
        answers = row.answers(least)
        if row.inside:
            count["silent" if not answers else "right" if row.right else "wrong"] += 1
        else:
            count["stray" if answers else "quiet"] += 1
            count["alone"] += answers and not row.ambiguous
    return Outcome(least, *count.values())


def tables(rows: list[Attempt]) -> list[tuple[str, list[str], list[list[str]]]]:
    """Title, columns and rows of each table to print."""
    return [
        (f"Answers by the least number of pairings, {_JUDGED}", *answers_table(rows)),
        ("Localities: answers under the rule and from six pairings, effort", *localities_table(rows)),
        ("How far right and wrong answers of six pairings or more lie apart", *apart_table(rows)),
    ]


def answers_table(rows: list[Attempt]) -> Table:
    """Right, wrong and none by search, sizes and k."""
    columns = ["place", "search", "sizes", "pairings", "right", "wrong", "none", "right of inside", "wrong of inside"]
    out = []
    for (place, search, sizes), group in _grouped([r for r in rows if r.locality == _JUDGED], _kind):
        for least in LEAST:
            o = outcome(group, least)
            shown = [str(n) for n in (o.right, o.wrong, o.silent)]
            shares = [text(o.right, o.inside), text(o.wrong, o.inside)]
            stray = [str(o.wrong_outside), str(o.silent_outside), text(o.wrong_outside, o.outside)]
            asked = "rule" if least == RULE else f">= {least}"
            out.append([place, search, sizes, asked, *shown, *shares, *stray])
    return [*columns, "outside: wrong", "none", "wrong of outside"], out


def localities_table(rows: list[Attempt]) -> Table:
    """The same under each locality, for the rule and for six; nodes and time inside and outside."""
    columns = ["place", "search", "sizes", "locality", "rule: right", "wrong", "outside", "six: right", "wrong"]
    out = []
    for key, group in _grouped(rows, lambda r: (*_kind(r), r.locality)):
        rule, six = outcome(group, RULE), outcome(group, 6)
        counts = [rule.right, rule.wrong, rule.wrong_outside, six.right, six.wrong, six.wrong_outside]
        effort = [f"{np.median([r.nodes for r in group]):.0f}"]
        for inside in (True, False):
            ms = [r.milliseconds for r in group if r.inside is inside]
            effort.append(f"{np.median(ms):.2f} / {np.percentile(ms, 95):.2f}")
        out.append([*key, *map(str, counts), *effort, str(sum(r.limit_hit for r in group))])
    order = {name: at for at, name in enumerate(LOCALITIES)}
    out.sort(key=lambda row: (row[:3], order[row[3]]))
    return [*columns, "outside", "nodes", "ms inside, median / 95 %", "ms outside", "limit hit"], out


def apart_table(rows: list[Attempt]) -> Table:
    """Distances from the reference and from the GPS, which show how little the bound of `near` decides."""
    out = []
    for (place,), group in _grouped([r for r in rows if r.inside and r.pairings >= 6], lambda r: (r.place,)):
        for right in (True, False):
            chosen = [r for r in group if r.right is right]
            metres = np.array([r.metres for r in chosen])
            gps = np.array([r.metres_gps for r in chosen])
            gps = gps[np.isfinite(gps)]
            out.append([place, "right" if right else "wrong", str(len(chosen)), _span(metres), _span(gps)])
    return ["place", "answers", "number", "m from the reference, 0 / 5 / 50 / 95 / 100 %", "m from the GPS"], out


def _span(values: np.ndarray) -> str:
    if not len(values):
        return ""
    return " / ".join(f"{v:.2f}" for v in np.percentile(values, [0, 5, 50, 95, 100]))


def _kind(row: Attempt) -> tuple[str, str, str]:
    return row.place, row.search, "used" if row.sizes else "unknown"


_Key = tuple[str, ...]


def _grouped(rows: list[Attempt], key: Callable[[Attempt], _Key]) -> list[tuple[_Key, list[Attempt]]]:
    groups: dict[_Key, list[Attempt]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return list(groups.items())


def write(rows: list[Attempt], folder: Path) -> None:
    """One CSV line for each attempt, and a picture where matplotlib is installed."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "relocations.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    try:
        from slam_gym.bench.recordings import plots as recordings_plots
    except ImportError:
        print("no pictures: matplotlib is not installed")
        return
    recordings_plots.save(rows, folder)


def run(data: Path, setting: Setting, only: str | None = None) -> list[Attempt]:
    """All attempts, telling what is under way."""
    makers = {
        "room": functools.partial(room, data / "mrclam" / "stationary", setting.groups),
        "park": functools.partial(park, data / "victoria_park", setting.associations, setting.scans),
    }
    rows: list[Attempt] = []
    for name, make in makers.items():
        if only in (None, name):
            start = time.perf_counter()
            rows += attempts(make(), setting)
            print(f"{name}: {time.perf_counter() - start:.0f} s", flush=True)
    return rows


def main(argv: list[str] | None = None) -> None:
    """Print the tables; with --out, write every attempt and a picture into a folder."""
    parser = argparse.ArgumentParser(prog="python -m slam_gym.bench recordings", description=__doc__)
    parser.add_argument("--data", type=Path, help="folder of the recordings (default: environment SLAM_GYM_DATA)")
    parser.add_argument("--only", choices=("room", "park"), help="one of the two places")
    parser.add_argument("--quick", action="store_true", help="fewer scans, one map of the park: under a minute")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the CSV file and the picture")
    arguments = parser.parse_args(argv)
    given = arguments.data or os.environ.get("SLAM_GYM_DATA")
    if not given:
        parser.error("no data: name their folder with --data or SLAM_GYM_DATA (victoria_park/, mrclam/stationary/)")
    rows = run(Path(given), QUICK if arguments.quick else FULL, arguments.only)
    for table in tables(rows):
        show(*table)
    if arguments.out:
        write(rows, arguments.out)
