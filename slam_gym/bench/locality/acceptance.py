"""How many pairings make a relocation believable: right, wrong or no answer, inside the map and outside of it.

A hypothesis is an answer when it has at least k pairings; under the rule, when the search accepts it: with as many as
`min_pairings` asks for, at one pose only. Inside the map it is right when its pose is (`locality_sweep.same_place`);
outside, every answer is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv

from slam_gym.bench.locality.sweep import Cell, attempt
from slam_gym.bench.locality.worlds import inside, mapped_field, outside
from slam_gym.metrics.statistics import Interval
from slam_gym.types import Relocator

RULE = 0
"""In place of a number of pairings: what the search itself accepts."""


@dataclass(frozen=True)
class Outcome:
    """Scans by what came of them when k pairings are asked for."""

    least: int  # k, or RULE
    right: int
    wrong: int
    silent: int  # inside
    wrong_outside: int
    silent_outside: int
    alone_outside: int  # of the wrong ones, those without a rival at another pose

    @property
    def inside(self) -> int:
        return self.right + self.wrong + self.silent

    @property
    def outside(self) -> int:
        return self.wrong_outside + self.silent_outside


def gather(
    name: str, search: Relocator, m: int, n: int, scans: int, seed: int, locality: str, maps: int = 10
) -> tuple[Cell, Cell]:
    """The search on `scans` scans inside and as many outside, over several maps: cells of both."""
    within, without = (Cell(name, locality, n, m) for _ in range(2))
    for number in range(maps):
        rng = np.random.default_rng([seed, n, m, number])
        area = mapped_field(n, rng)
        local = area.locality(locality)
        for _ in range(len(range(number, scans, maps))):
            attempt(within, search, area, inside(area, m, m // 4, rng), local)
            attempt(without, search, area, outside(area, m, rng), local)
    return within, without


def outcomes(within: Cell, without: Cell) -> list[Outcome]:
    """For k = 2 … m, and for the rule."""
    return [outcome(within, without, least) for least in (RULE, *range(2, within.m + 1))]


def outcome(within: Cell, without: Cell, least: int) -> Outcome:
    """What came of the scans when `least` pairings are asked for (RULE: when the search is believed)."""
    answered = [
        cell.array("accepted") == 1.0 if least == RULE else cell.array("pairings") >= least
        for cell in (within, without)
    ]
    found, stray = within.array("found") == 1.0, answered[1]
    right, wrong = int((answered[0] & found).sum()), int((answered[0] & ~found).sum())
    alone = int((stray & (without.array("ambiguous") == 0.0)).sum())
    silent = len(found) - right - wrong
    return Outcome(least, right, wrong, silent, int(stray.sum()), int((~stray).sum()), alone)


def share(count: int, total: int) -> Interval:
    """A share and its exact (Clopper–Pearson) 95 % interval; for none in N, up to the 3/N of the one-sided one."""
    if count == 0:
        return Interval(0.0, 0.0, min(3.0 / total, 1.0))
    low = float(betaincinv(count, total - count + 1, 0.025))
    high = 1.0 if count == total else float(betaincinv(count + 1, total - count, 0.975))
    return Interval(count / total, low, high)


def text(count: int, total: int) -> str:
    """A share with its interval, to print."""
    interval = share(count, total)
    if count == 0:
        return f"<= {interval.high:.4f}"
    return f"{interval.estimate:.3f} [{interval.low:.3f}, {interval.high:.3f}]"
