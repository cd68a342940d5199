"""Searches without a prior, counted: effort, hits and losses over scans of `locality_worlds`.

A **pairing test** is a unary or a binary one; what is not local to the first pairing is not tested. A scan is **found**
when the located pose lies within 1 m and 5° of where its true pairings put the robot, whatever the number of pairings.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from slam_gym.association.relocation.location import locate
from slam_gym.bench.locality.bound import hypotheses
from slam_gym.bench.locality.worlds import LOCALITIES, Field, Look, inside, mapped_field
from slam_gym.geometry import wrap_angle
from slam_gym.mapping.locality import locality_sizes
from slam_gym.metrics.statistics import Interval
from slam_gym.types import NONE, Array, Landmarks, Locality, Relocation, Relocator

NEAR = (1.0, math.radians(5.0))  # [m, rad] of the pose that the true pairings give
MEASURES = (
    "hypotheses",  # located and tested jointly
    "nodes",
    "tests",  # unary and binary
    "joint",
    "ms",
    "limit",  # 1: the search ended at its limit
    "right",  # pairings
    "wrong",  # pairings
    "possible",  # true pairings
    "found",
    "pairings",
    "rule",  # min_pairings of the acceptance rule
    "ambiguous",
    "accepted",
)


@dataclass
class Cell:
    """One search under one locality, for maps of n features and scans of m measurements."""

    search: str
    locality: str
    n: int
    m: int
    values: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in MEASURES})

    def __len__(self) -> int:
        return len(self.values["nodes"])

    def array(self, name: str) -> Array:
        return np.array(self.values[name], dtype=np.float64)

    def mean(self, name: str) -> float:
        return float(np.mean(self.values[name]))

    @property
    def recall(self) -> float:
        """Share of the true pairings that the hypotheses hold."""
        return float(np.sum(self.values["right"]) / max(np.sum(self.values["possible"]), 1.0))

    @property
    def whole(self) -> float:
        """Share of scans with all their true pairings."""
        return float(np.mean(self.array("right") == self.array("possible")))


@dataclass
class Reach:
    """A locality on maps of n features: its sizes, what they bound, and what it loses. Means over maps."""

    locality: str
    n: int
    m: int
    mean_size: float  # of |L(j)|
    largest_size: float
    hypotheses: float  # N_h of the unpruned tree, by the sum over features
    pairs: float  # lost, as in `out_of_reach`
    pairings: float
    scans: float
    anyhow: float


def as_it_came(look: Look) -> Look:
    """The scan with its measurements in the order in which they came."""
    return look


@dataclass(frozen=True)
class Plan:
    """What to run at each point of a sweep."""

    searches: dict[str, Relocator]
    localities: tuple[str, ...]
    scans: int
    seed: int
    tests: float  # pairing tests per cell; where more are to be expected, it gets fewer scans
    least: int = 3  # scans: where fewer can be afforded, the series ends
    arrange: Callable[[Look], Look] = as_it_came  # what to do with the measurements of a scan


Key = tuple[str, str]
"""Search and locality."""


def sweep(
    plan: Plan, points: Sequence[tuple[int, int]], growth: Callable[[str, int, int], float]
) -> tuple[list[Cell], list[Reach]]:
    """All searches under all localities at each (n, m).

    A series ends where its cell would cost too much, foretold from the tests of the point before times
    growth(locality, point before, point), or where half of the searches ended at their limit.
    """
    cells: list[Cell] = []
    reaches: list[Reach] = []
    took: dict[Key, float] = {(search, name): 0.0 for search in plan.searches for name in plan.localities}
    for at, (n, m) in enumerate(points):
        scans = {}
        for key, tests in took.items():
            expected = tests * growth(key[1], max(at - 1, 0), at)
            scans[key] = int(min(plan.scans, plan.tests / max(expected, 1.0)))
        new, reach = point(plan, n, m, {key: count for key, count in scans.items() if count >= plan.least})
        cells, reaches = cells + new, reaches + reach
        took = {(cell.search, cell.locality): cell.mean("tests") for cell in new if cell.mean("limit") < 0.5}
    return cells, reaches


def point(plan: Plan, n: int, m: int, scans: dict[Key, int]) -> tuple[list[Cell], list[Reach]]:
    """So many scans of m measurements for each search and locality, over several maps where n is small."""
    maps = min(max(3200 // n, 1), 5, plan.scans)
    cells = {key: Cell(*key, n, m) for key in scans}
    reaches = []
    for number in range(maps):
        rng = np.random.default_rng([plan.seed, n, m, number])
        area = mapped_field(n, rng)
        looks = [plan.arrange(inside(area, m, m // 4, rng)) for _ in range(number, plan.scans, maps)]
        for name in LOCALITIES:
            locality = area.locality(name)
            reaches.append(_reach(name, n, m, locality, looks))
            for search, relocate in plan.searches.items():
                if (search, name) in cells:
                    count = len(range(number, scans[search, name], maps))
                    for look in looks[:count]:
                        attempt(cells[search, name], relocate, area, look, locality)
    return list(cells.values()), [_mean([r for r in reaches if r.locality == name]) for name in LOCALITIES]


def _reach(name: str, n: int, m: int, locality: Locality | None, looks: Sequence[Look]) -> Reach:
    sizes = locality_sizes(locality, n)
    lost = out_of_reach(looks, locality)
    return Reach(name, n, m, float(sizes.mean()), float(sizes.max()), hypotheses(sizes, m), **lost)


def _mean(rows: Sequence[Reach]) -> Reach:
    names = [field.name for field in fields(Reach)][3:]
    means = {name: float(np.mean([getattr(row, name) for row in rows])) for name in names}
    return Reach(rows[0].locality, rows[0].n, rows[0].m, **means)


def attempt(cell: Cell, search: Relocator, area: Field, look: Look, locality: Locality | None) -> Relocation:
    """Relocate one scan and write down what it took and what came of it."""
    start = time.perf_counter()
    answer = search(look.scan, area.landmarks, locality)
    seconds = time.perf_counter() - start
    paired, true = answer.features != NONE, look.truth != NONE
    right = int((paired & (answer.features == look.truth)).sum())
    effort = answer.effort
    row = {
        "hypotheses": effort.leaves,
        "nodes": effort.nodes,
        "tests": effort.unary_tests + effort.binary_tests,
        "joint": effort.joint_tests,
        "ms": 1e3 * seconds,
        "limit": effort.limit_hit,
        "right": right,
        "wrong": int(paired.sum()) - right,
        "possible": int(true.sum()),
        "found": same_place(answer, look, area.landmarks),
        "pairings": answer.pairings,
        "rule": answer.min_pairings,
        "ambiguous": answer.ambiguous,
        "accepted": answer.accepted,
    }
    for name, value in row.items():
        cell.values[name].append(float(value))
    return answer


def same_place(answer: Relocation, look: Look, landmarks: Landmarks) -> bool:
    """Whether the pose found is the one that the true pairings give, in the drifted map; never, outside of it."""
    if (look.truth != NONE).sum() < 2 or not np.isfinite(answer.pose).all():
        return False
    true = locate(look.scan, landmarks, look.truth).pose
    away = math.hypot(answer.pose[0] - true[0], answer.pose[1] - true[1])
    return away < NEAR[0] and abs(wrap_angle(answer.pose[2] - true[2])) < NEAR[1]


def out_of_reach(looks: Iterable[Look], locality: Locality | None) -> dict[str, float]:
    """What a locality loses before any test: shares.

    `pairs`: of two features seen in one scan, that are not local to each other. `pairings`: of the true pairings, that
    no hypothesis holds which takes the measurements in the order of the scan, so that its first one decides; `scans`:
    that have no such hypothesis with all of them; `anyhow`: nor if any of them may come first, as in random sampling.
    """
    pairs = lost = true = reached = whole = anyhow = count = 0
    for look in looks:
        T = look.truth[look.truth != NONE]
        local = (
            np.ones((len(T), len(T)), bool) if locality is None else np.array([np.isin(T, locality.of(j)) for j in T])
        )
        pairs, lost = pairs + len(T) * (len(T) - 1), lost + int((~local).sum())
        true, reached = true + len(T), reached + int(np.triu(local).sum(axis=1).max())
        whole, anyhow, count = whole + bool(local[0].all()), anyhow + bool(local.all(axis=1).any()), count + 1
    return {
        "pairs": lost / pairs,
        "pairings": 1.0 - reached / true,
        "scans": 1.0 - whole / count,
        "anyhow": 1.0 - anyhow / count,
    }


def power(cells: Sequence[Cell], axis: Callable[[Cell], float], name: str, rng: np.random.Generator) -> Interval:
    """Exponent p of the means ∝ axis^p, by least squares on logarithms; 95 % by resampling the scans of each cell."""
    x = np.log([axis(cell) for cell in cells])
    return _slope(x, cells, name, rng)


def growth(cells: Sequence[Cell], name: str, rng: np.random.Generator) -> Interval:
    """Factor by which the means grow with each further measurement, likewise."""
    slope = _slope(np.array([float(cell.m) for cell in cells]), cells, name, rng)
    return Interval(math.exp(slope.estimate), math.exp(slope.low), math.exp(slope.high))


def _slope(x: Array, cells: Sequence[Cell], name: str, rng: np.random.Generator, resamples: int = 2000) -> Interval:
    if len(cells) < 2:
        return Interval(math.nan, math.nan, math.nan)
    values = [cell.array(name) for cell in cells]
    means = [v[rng.integers(0, len(v), (resamples, len(v)))].mean(axis=1) for v in values]
    centred = x - x.mean()
    weights = centred / (centred @ centred)
    drawn = weights @ np.log(np.maximum(means, 1e-12))
    estimate = weights @ np.log([max(v.mean(), 1e-12) for v in values])
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Interval(float(estimate), float(low), float(high))
