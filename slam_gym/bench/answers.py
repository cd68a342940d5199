"""Relocations tried and judged: right, wrong or no answer, from inside the map and from outside of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.special import betaincinv

from slam_gym.bench.records import Record, column
from slam_gym.bench.timing import timed
from slam_gym.geometry import wrap_angle
from slam_gym.metrics.statistics import Interval
from slam_gym.types import Array, Landmarks, Locality, Relocation, Relocator, Scan

ACCEPTED = 0
"""In place of a number of pairings: what the search itself accepts."""

_Sized = TypeVar("_Sized", Scan, Landmarks)


class Tolerance(NamedTuple):
    """How far a pose may be off and still be right."""

    metres: float
    radians: float

    def holds(self, found: Array, true: Array) -> bool:
        """Whether the pose `found` (3,) is right; never where one of them is NaN."""
        off = found - true
        return math.hypot(off[0], off[1]) < self.metres and abs(wrap_angle(float(off[2]))) < self.radians


class Attempt(NamedTuple):
    """An answer, and what it took."""

    answer: Relocation
    record: Record


def attempt(search: Relocator, scan: Scan, landmarks: Landmarks, locality: Locality | None) -> Attempt:
    """Relocate one scan."""
    answer, microseconds = timed(search, scan, landmarks, locality)
    effort = answer.effort
    return Attempt(answer, {
        "measurements": len(scan),
        "pairings": answer.pairings,
        "min pairings": answer.min_pairings,
        "ambiguous": answer.ambiguous,
        "accepted": answer.accepted,
        "hypotheses": effort.leaves,
        "nodes": effort.nodes,
        "pairing tests": effort.unary_tests + effort.binary_tests,
        "joint tests": effort.joint_tests,
        "limit hit": effort.limit_hit,
        "ms": 1e-3 * microseconds,
    })  # fmt: skip


def count_answers(records: Sequence[Record], asked: int) -> Record:
    """What came of scans when `asked` pairings are asked for (ACCEPTED: when the search is believed).

    Records say whether each scan is from `inside` the map and whether the pose found is `right`; outside, every answer
    is wrong, and one without a rival at another pose is the worst.
    """
    inside, right, ambiguous = (column(records, name) == 1.0 for name in ("inside", "right", "ambiguous"))
    given = column(records, "accepted") == 1.0 if asked == ACCEPTED else column(records, "pairings") >= asked
    right, wrong, stray = (
        int(which.sum()) for which in (inside & given & right, inside & given & ~right, ~inside & given)
    )
    scans, strangers = int(inside.sum()), int((~inside).sum())
    return {
        "asked": "rule" if asked == ACCEPTED else f">= {asked}",
        **{"right": right, "wrong": wrong, "none": scans - right - wrong},
        "right of inside": proportion(right, scans),
        "wrong of inside": proportion(wrong, scans),
        **{"outside: wrong": stray, "outside: none": strangers - stray},
        "wrong of outside": proportion(stray, strangers),
        "at one pose": proportion(int((~inside & given & ~ambiguous).sum()), strangers),
    }


def proportion(count: int, total: int) -> Interval:
    """`count` of `total` with the exact (Clopper–Pearson) 95 % interval; for none, up to the one-sided 3 / total."""
    if count == 0:
        return Interval(0.0, 0.0, min(3.0 / total, 1.0)) if total else Interval(math.nan, math.nan, math.nan)
    low = float(betaincinv(count, total - count + 1, 0.025))
    high = 1.0 if count == total else float(betaincinv(count + 1, total - count, 0.975))
    return Interval(count / total, low, high)


def without_sizes(given: _Sized) -> _Sized:
    """The same scan or map with all sizes unknown."""
    unknown = np.full(len(given), math.nan)
    return replace(given, sizes=unknown, size_variances=unknown.copy())
