"""Searches without a prior, counted: effort, hits and losses over scans of `fields`.

A **pairing test** is a unary or a binary one; what is not local to the first pairing is not tested. A scan is `right`
when the located pose lies within 1 m and 5° of where its true pairings put the robot, whatever the number of pairings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slam_gym.association.relocation.location import locate
from slam_gym.bench.answers import Tolerance, attempt
from slam_gym.bench.locality.fields import LOCALITIES, FieldScan, SurveyedField, inside, outside, surveyed_field
from slam_gym.bench.locality.hypothesis_count import hypotheses
from slam_gym.bench.records import Record, column, grouped, means
from slam_gym.mapping.locality import locality_sizes
from slam_gym.types import UNPAIRED, BoolArray, IntArray, Landmarks, Locality, Relocation, Relocator

NEAR = Tolerance(1.0, math.radians(5.0))  # of the pose that the true pairings give


def as_it_came(scan: FieldScan) -> FieldScan:
    """The scan with its measurements in the order in which they came."""
    return scan


@dataclass(frozen=True)
class SweepSpec:
    """What to run at each point of a sweep."""

    searches: Mapping[str, Relocator]
    localities: tuple[str, ...]
    scans: int
    seed: int
    max_tests: float  # pairing tests of all scans together; where more are to be expected, fewer scans are taken
    min_scans: int = 3  # where fewer can be afforded, the series ends
    arrange: Callable[[FieldScan], FieldScan] = as_it_came  # what to do with the measurements of a scan


class Sweep(NamedTuple):
    """All that was counted at the points of a sweep."""

    attempts: list[Record]  # one per scan and search: search, locality, n, m, …
    localities: list[Record]  # one per locality and point


ExpectedGrowth = Callable[[str, int, int], float]
"""From a locality, a point and the next one, by number: the factor by which the tests are expected to grow."""

Series = tuple[str, str]
"""A search and a locality."""


def sweep(spec: SweepSpec, points: Sequence[tuple[int, int]], growth: ExpectedGrowth | None = None) -> Sweep:
    """All searches under all localities at each (n, m).

    A series ends where its scans would cost too much, foretold from the tests of the point before times `growth`
    (default: none), or where half of the searches ended at their limit.
    """
    whole = Sweep([], [])
    spent = {
        (search, locality): 0.0 for search in spec.searches for locality in spec.localities
    }  # mean tests of a scan
    for at, (n, m) in enumerate(points):
        scans: dict[Series, int] = {}
        for series, tests in spent.items():
            expected = tests * (growth(series[1], max(at - 1, 0), at) if growth else 1.0)
            scans[series] = int(min(spec.scans, spec.max_tests / max(expected, 1.0)))
        found = sweep_point(spec, n, m, {series: count for series, count in scans.items() if count >= spec.min_scans})
        whole.attempts.extend(found.attempts)
        whole.localities.extend(found.localities)
        groups = [(tuple(key.values()), group) for key, group in grouped(found.attempts, "search", "locality")]
        spent = {
            k: means(g, "pairing tests")["pairing tests"] for k, g in groups if column(g, "limit hit").mean() < 0.5
        }
    return whole


def sweep_point(spec: SweepSpec, n: int, m: int, scans: Mapping[Series, int]) -> Sweep:
    """So many scans of m measurements for each series, over several maps where n is small."""
    maps = min(max(3200 // n, 1), 5, spec.scans)
    attempts: list[Record] = []
    localities: list[Record] = []
    for number in range(maps):
        rng = np.random.default_rng([spec.seed, n, m, number])
        area = surveyed_field(n, rng)
        drawn = [spec.arrange(inside(area, m, m // 4, rng)) for _ in range(number, spec.scans, maps)]
        for name in LOCALITIES:
            locality, key = area.locality(name), {"locality": name, "n": n, "m": m}
            localities.append(key | locality_figures(n, m, locality, [scan.truth for scan in drawn]))
            for search, relocate in spec.searches.items():
                count = len(range(number, scans.get((search, name), 0), maps))
                tried = (relocate_in_field(relocate, area, scan, locality) for scan in drawn[:count])
                attempts.extend({"search": search, **key, **record} for record in tried)
    names = [name for name in localities[0] if name not in ("locality", "n", "m")]
    of_maps = [key | means(group, *names) for key, group in grouped(localities, "locality", "n", "m")]
    return Sweep(attempts, of_maps)


def relocate_in_field(search: Relocator, area: SurveyedField, drawn: FieldScan, locality: Locality | None) -> Record:
    """Relocate one scan."""
    answer, record = attempt(search, drawn.scan, area.landmarks, locality)
    paired, true = answer.features != UNPAIRED, drawn.truth != UNPAIRED
    right = int((paired & (answer.features == drawn.truth)).sum())
    return record | {
        "inside": bool(np.isfinite(drawn.pose).all()),
        "right": same_place(answer, drawn, area.landmarks),
        "right pairings": right,
        "true pairings": int(true.sum()),
        "all right": right == true.sum(),
    }


def same_place(answer: Relocation, drawn: FieldScan, landmarks: Landmarks) -> bool:
    """Whether the pose found is the one that the true pairings give, in the drifted map; never, outside of it."""
    if (drawn.truth != UNPAIRED).sum() < 2 or not np.isfinite(answer.pose).all():
        return False
    return NEAR.holds(answer.pose, locate(drawn.scan, landmarks, drawn.truth).pose)


def inside_and_outside(
    search: Relocator, locality: str, size: tuple[int, int], scans: int, seed: int, maps: int = 10
) -> list[Record]:
    """Attempts at `scans` scans from inside the map and as many from outside, for `size` (n, m), over several maps."""
    (n, m), records = size, []
    for number in range(maps):
        rng = np.random.default_rng([seed, n, m, number])
        area = surveyed_field(n, rng)
        local = area.locality(locality)
        for _ in range(number, scans, maps):
            records.append(relocate_in_field(search, area, inside(area, m, m // 4, rng), local))
            records.append(relocate_in_field(search, area, outside(area, m, rng), local))
    return records


def locality_figures(n: int, m: int, locality: Locality | None, truths: Sequence[IntArray]) -> Record:
    """Mean and largest |L(j)| of a map of n features, N_h of the unpruned tree, and losses over the true hypotheses."""
    sizes = locality_sizes(locality, n)
    figures = {"mean c": float(sizes.mean()), "max c": float(sizes.max()), "N_h": hypotheses(sizes, m)}
    return figures | losses(truths, locality)


def losses(truths: Sequence[IntArray], locality: Locality | None) -> dict[str, float]:
    """Fractions of what a locality loses before any test, from the feature (m,) behind each measurement of each scan.

    `pairs`: of two features seen in one scan, that are not local to each other. `pairings`: of the true pairings, that
    no hypothesis holds which takes the measurements in the order of the scan, so that its first one decides; `scans`:
    that have no such hypothesis with all of them; `anyhow`: nor if any of them may come first, as in random sampling.
    """
    local = [_local(truth[truth != UNPAIRED], locality) for truth in truths]
    pairs, true = sum(len(one) * (len(one) - 1) for one in local), sum(len(one) for one in local)
    return {
        "pairs": sum(int((~one).sum()) for one in local) / pairs,
        "pairings": 1.0 - sum(int(np.triu(one).sum(axis=1).max()) for one in local) / true,
        "scans": 1.0 - float(np.mean([one[0].all() for one in local])),
        "anyhow": 1.0 - float(np.mean([one.all(axis=1).any() for one in local])),
    }


def _local(features: IntArray, locality: Locality | None) -> BoolArray:
    """(k, k) which of the features are local to which."""
    if locality is None:
        return np.ones((len(features), len(features)), np.bool_)
    return np.array([np.isin(features, locality.of(feature)) for feature in features])
