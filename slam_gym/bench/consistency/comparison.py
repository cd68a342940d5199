"""Which estimator stays consistent on a long loop: EKF, right-invariant, local maps joined.

The same logs for all, with JCBB and with the true association: a corridor driven round, a hall and an office explored,
Victoria Park. Runs are paired by seed: differences from the standard EKF are interquartile means with 95 % bootstrap
intervals. A loop counts as closed where fewer than five features are duplicates at the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from slam_gym.bench.answers import proportion
from slam_gym.bench.consistency.estimators import ASSOCIATORS, METHODS, DrivenLog, estimate
from slam_gym.bench.consistency.logs import LoopSpec, floor, hall, loop, park
from slam_gym.bench.recordings.places import gps_at
from slam_gym.bench.records import Record, column, grouped, means, medians
from slam_gym.bench.report import Report
from slam_gym.bench.runner import UsageError, data_folder
from slam_gym.metrics.statistics import Interval, paired_difference
from slam_gym.metrics.trajectory import ate
from slam_gym.types import Array

CLOSED = 5  # duplicates
WORLDS = ("loop", "hall", "floor", "park")
_MEDIANS = ("error [m]", "final [m]", "final [°]", "heading σ [°]", "map RMSE [m]", "GPS [m]")
_COMPARED: dict[str, Callable[[Array], Array]] = {
    "ANEES": np.log10,
    "error [m]": np.asarray,
    "final [m]": np.asarray,
    "duplicates": np.asarray,
    "seconds": np.log10,
}


class Workload(NamedTuple):
    """How much is run."""

    loops: int  # seeds of each loop
    halls: int
    hall_ticks: int
    floors: int
    floor_ticks: int
    park_steps: int | None
    corridors: tuple[LoopSpec, ...]


_CORRIDORS = (LoopSpec(0.5), LoopSpec(2.0), LoopSpec(5.0), LoopSpec(2.0, spacing=8.0))
FULL = Workload(40, 8, 600, 3, 1500, None, _CORRIDORS)
QUICK = Workload(6, 2, 300, 1, 300, 1500, (LoopSpec(2.0),))


def estimates(logs: Iterable[DrivenLog]) -> list[Record]:
    """Every method with every associator on every log."""
    return [
        estimate(log, method, a).record | {"GPS [m]": math.nan}
        for log in logs
        for a in ASSOCIATORS
        for method in METHODS
    ]


def park_estimates(folder: Path, steps: int | None) -> list[Record]:
    """Likewise on Victoria Park, with the RMS distance [m] from the GPS over checkpoints, aligned."""
    log, recording = park(folder, steps)
    fixes = np.array([gps_at(recording, float(recording.times[k])) for k in log.checked.tolist()])
    known = np.isfinite(fixes).all(axis=1)
    records = []
    for associator in ASSOCIATORS:
        for method in METHODS:
            record, poses = estimate(log, method, associator)
            records.append(record | {"GPS [m]": ate(poses[known, :2], fixes[known], aligned=True)})
    return records


def runs_table(records: Sequence[Record]) -> list[Record]:
    """World by world, associator by associator, the methods beneath each other: medians, of ANEES with quartiles."""
    rows = []
    for key, group in grouped(records, "world", "associator", "method"):
        anees = Interval(*np.percentile(column(group, "ANEES"), [50, 25, 75]).tolist())
        row = {**key, "runs": len(group), "ANEES": anees, **means(group, "optimistic"), **medians(group, *_MEDIANS)}
        row |= means(group, "duplicates", "features")
        closed = sum(record["duplicates"] < CLOSED for record in group)
        row["closed"] = proportion(closed, len(group)) if key["world"].startswith("loop") else ""
        rows.append(row | medians(group, "seconds"))
    return rows


def differences_table(records: Sequence[Record]) -> list[Record]:
    """Interquartile means of the differences from the standard EKF, over the seeds; of ANEES and time in log10."""
    rows = []
    standard: list[Record] = []
    for key, group in grouped(sorted(records, key=lambda r: r["seed"]), "world", "associator", "method"):
        if key["method"] == METHODS[0]:
            standard = group
        elif len(group) >= 3:
            row = key
            for name, scale in _COMPARED.items():
                ours, theirs = (scale(column(records, name)) for records in (group, standard))
                heading = f"log10 {name}" if scale is np.log10 else name
                row[heading] = paired_difference(ours, theirs, np.random.default_rng(0))
            rows.append(row)
    return rows


Makers = dict[str, Callable[[], list[Record]]]


def makers(w: Workload, data: Path | None, plan: Path | None) -> Makers:
    """What runs on each of the worlds that there is data for."""
    found: Makers = {
        "loop": lambda: estimates(loop(seed, spec) for spec in w.corridors for seed in range(w.loops)),
        "hall": lambda: estimates(hall(seed, w.hall_ticks) for seed in range(w.halls)),
    }
    floor_plan = plan or (data and data / "willow_garage" / "willow-full.pgm")
    if floor_plan:
        found["floor"] = lambda: estimates(floor(floor_plan, seed, w.floor_ticks) for seed in range(w.floors))
    if data:
        found["park"] = lambda: park_estimates(data / "victoria_park", w.park_steps)
    return found


def run(
    report: Report,
    *,
    data: Path | None = None,
    plan: Path | None = None,
    only: Literal["loop", "hall", "floor", "park"] | None = None,
    quick: bool = False,
) -> None:
    """Two tables, and every run in a CSV file.

    Arguments:
        data: folder of the recordings (default: environment SLAM_GYM_DATA)
        plan: floor plan image, 0.1 m a pixel (default: Willow Garage in --data)
        only: one of the worlds
        quick: fewer and shorter runs: under a minute
    """
    estimate(loop(0, LoopSpec(side=10)), "local maps", "jcbb")  # compiles
    records: list[Record] = []
    known = makers(QUICK if quick else FULL, data_folder(data), plan)
    for name in WORLDS if only is None else (only,):
        if name not in known:
            report.say(f"{name}: left out, no data (--data or SLAM_GYM_DATA)")
            continue
        with report.part(name):
            records += known[name]()
    if not records:
        raise UsageError("nothing was run")
    report.table("Runs: medians, of ANEES with quartiles", runs_table(records))
    report.table("Differences from the standard EKF on the same logs", differences_table(records))
    report.rows("consistency", records)
