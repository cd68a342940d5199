"""What locality saves relocation, against the bound of the source, and what it costs.

Equation 9.22 counted hypothesis by hypothesis; effort of GCBB and of random sampling (RS) against the size of the map
and the number of measurements, under each locality; what each locality loses; how many pairings make an answer
believable: right, wrong or none, inside the map and outside of it. The axes are those of the reference experiment: .02
features per m², range 15 m, 180°, one lawn-mower pass, a quarter of the measurements spurious, sizes and kinds unknown.
Pairing tests are unary and binary ones. GCBB is run as in the source for the effort, with the search for rivals where
answers are judged.

With --tracking: what covisibility saves JCBB in exploration, where a prior on the pose has gated the candidates.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.association.relocation.random_sampling import random_sampling
from slam_gym.bench.locality import pictures
from slam_gym.bench.locality.effort_tables import (
    answers_table,
    effort_table,
    exponents_table,
    growth_table,
    localities_table,
)
from slam_gym.bench.locality.fields import LOCALITIES, from_centre
from slam_gym.bench.locality.hypothesis_count import verify
from slam_gym.bench.locality.sweep import Sweep, SweepSpec, as_it_came, inside_and_outside, sweep
from slam_gym.bench.records import Record
from slam_gym.bench.report import Report
from slam_gym.types import Relocator

SEARCHED = tuple(name for name in LOCALITIES if name != "joined maps")  # its loss is shown; nobody would search it
JUDGED_UNDER = "two hops"  # locality under which answers are judged
JUDGED_IN = 400  # features of the maps in which they are
M = 8  # measurements while n varies


class Workload(NamedTuple):
    """How much is run."""

    maps: tuple[int, ...]  # features
    measurements: tuple[int, ...]
    fixed: int  # features while m varies
    scans: int
    max_tests: float  # pairing tests per series and point
    judged: int  # scans inside, and as many outside, for each m
    judged_measurements: tuple[int, ...] = (6, 8, 10)
    fitted_from: int = 800  # features: exponents in n are fitted to maps of so many and more


FULL = Workload((50, 100, 200, 400, 800, 1600, 3200, 6400, 12800), (4, 6, 8, 10, 12, 14, 16), 400, 30, 1.1e9, 500)
QUICK = Workload((50, 100, 200, 400, 800, 1600), (4, 6, 8), 200, 6, 2.2e8, 30)


def searches(confidence: float = 0.99, *, rivals: bool = False) -> dict[str, Relocator]:
    """GCBB, with or without the search for rivals, and RS, by the names they have in the tables."""
    return {
        "GCBB": functools.partial(gcbb, confidence=confidence, rivals=rivals),
        "RS": functools.partial(random_sampling, confidence=confidence),
    }


def effort_against_map(w: Workload, seed: int) -> Sweep:
    """The sweep over n. A scan takes n times what it took before under a locality, n² times without."""
    n, spec = w.maps, SweepSpec(searches(), SEARCHED, w.scans, seed, w.max_tests)
    points = [(k, M) for k in n]
    return sweep(spec, points, lambda name, a, b: (n[b] / n[a]) ** (2.0 if name == "everything" else 1.0))


def effort_against_measurements(w: Workload, seed: int) -> Sweep:
    """The sweep over m in maps of `w.fixed` features."""
    m, spec = w.measurements, SweepSpec(searches(), SEARCHED, w.scans, seed, w.max_tests)
    return sweep(spec, [(w.fixed, k) for k in m], lambda _, a, b: 1.7 ** (m[b] - m[a]))


def effect_of_settings(w: Workload, seed: int) -> list[Record]:
    """Gates of .95 and .99, and measurements taken from the centre of the scan outwards, on the same scans."""
    attempts = []
    for setting, confidence, arrange in (
        ("gates of .95", 0.95, as_it_came),
        ("gates of .99", 0.99, as_it_came),
        ("from the centre", 0.99, from_centre),
    ):
        names = ("covisibility", "two hops", "everything")
        spec = SweepSpec(searches(confidence), names, 4 * w.scans, seed, w.max_tests, arrange=arrange)
        attempts += [{"setting": setting, **one} for one in sweep(spec, [(w.fixed, M)]).attempts]
    return attempts


def answers(w: Workload, seed: int) -> list[Record]:
    """Scans from inside and outside, to be judged, by search and m."""
    return [
        {"search": name, "m": m, **record}
        for m in w.judged_measurements
        for name, search in searches(rivals=True).items()
        for record in inside_and_outside(search, JUDGED_UNDER, (JUDGED_IN, m), w.judged, seed)
    ]


def run(report: Report, *, quick: bool = False, seed: int = 0) -> None:
    """Tables, CSV files of all that is behind them, and pictures.

    Arguments:
        quick: smaller maps, fewer scans: under a minute
        seed: of everything random
    """
    w = QUICK if quick else FULL
    sweep(SweepSpec(searches(), SEARCHED, 2, seed, math.inf), [(50, 6)])  # compiles
    with report.part("bound"):
        counts = verify(np.random.default_rng(seed))
    with report.part("maps"):
        maps = effort_against_map(w, seed)
    with report.part("measurements"):
        measurements = effort_against_measurements(w, seed)
    with report.part("settings"):
        settings = effect_of_settings(w, seed)
    with report.part("answers"):
        judged = answers(w, seed)
    largest = [row for row in counts if row["m"] == counts[-1]["m"]]
    in_two = f"Answers by the number of pairings asked for, n = {JUDGED_IN}, {JUDGED_UNDER}"
    answered = answers_table(in_two, judged)
    report.table("Equation 9.22 against hypotheses counted one by one", largest)
    for table in (
        localities_table(maps.localities),
        effort_table("Effort against the size of the map", maps.attempts),
        exponents_table(maps, w.fitted_from),
        effort_table("Effort against the number of measurements", measurements.attempts),
        growth_table(measurements),
        effort_table("Gates, and the order of measurements", settings, "setting"),
        answered,
    ):
        report.table(*table)
    for name, rows in {
        "bound": counts,
        "localities": maps.localities,
        "localities_by_m": measurements.localities,
        "map_size": maps.attempts,
        "measurements": measurements.attempts,
        "settings": settings,
        "answers": answered.rows,
    }.items():
        report.rows(name, rows)
    report.pictures({
        "map_size": lambda: pictures.effort(maps, "n", f"$m = {M}$"),
        "measurements": lambda: pictures.effort(measurements, "m", f"$n = {w.fixed}$"),
        "losses": lambda: pictures.losses(maps.localities),
        "answers": lambda: pictures.answers(answered.rows, f"answers under {JUDGED_UNDER}, $n = {JUDGED_IN}$"),
    })  # fmt: skip
