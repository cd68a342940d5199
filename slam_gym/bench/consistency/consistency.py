"""Which estimator stays consistent on a long loop: standard EKF, first-estimate Jacobians, or local maps joined.

The same logs for all (`consistency_worlds`), with JCBB and with the true association; figures are those of
`consistency_runs.Result`. Runs are paired by seed: differences from the standard EKF are interquartile means with 95 %
bootstrap intervals. A loop counts as closed where fewer than five features are duplicates at the end.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from slam_gym.bench.consistency.runs import ASSOCIATORS, METHODS, Log, Result, run
from slam_gym.bench.consistency.worlds import LoopSpec, floor, hall, loop, park
from slam_gym.bench.locality.acceptance import text
from slam_gym.bench.locality.tables import Table, show
from slam_gym.bench.recordings.places import gps_at
from slam_gym.metrics.statistics import paired_difference
from slam_gym.metrics.trajectory import ate

CLOSED = 5  # duplicates
_COMPARED: dict[str, Callable[[Result], float]] = {
    "log10 ANEES": lambda r: math.log10(r.anees),
    "error [m]": lambda r: r.error,
    "final error [m]": lambda r: r.final,
    "duplicates": lambda r: r.duplicates,
    "time, log10": lambda r: math.log10(r.seconds),
}


@dataclass(frozen=True)
class Setting:
    """How much is run."""

    loops: int  # seeds of each loop
    halls: int
    hall_ticks: int
    floors: int
    floor_ticks: int
    park_steps: int | None
    corridors: tuple[LoopSpec, ...]


_CORRIDORS = (LoopSpec(0.5), LoopSpec(2.0), LoopSpec(5.0), LoopSpec(2.0, spacing=8.0))
FULL = Setting(40, 8, 600, 3, 1500, None, _CORRIDORS)
QUICK = Setting(6, 2, 300, 1, 300, 1500, (LoopSpec(2.0),))
WORLDS = ("loop", "hall", "floor", "park")


def results(logs: Iterator[Log]) -> list[Result]:
    """Every method with every associator on every log."""
    return [run(log, method, associator)[0] for log in logs for associator in ASSOCIATORS for method in METHODS]


def park_results(folder: Path, steps: int | None) -> list[Result]:
    """Likewise on Victoria Park, with the error against the GPS."""
    log, recording = park(folder, steps)
    out = []
    for associator in ASSOCIATORS:
        for method in METHODS:
            result, at, poses = run(log, method, associator)
            fixes = np.array([gps_at(recording, float(recording.times[k])) for k in at.tolist()])
            known = np.isfinite(fixes).all(axis=1)
            out.append(replace(result, gps=ate(poses[known, :2], fixes[known], aligned=True)))
    return out


def run_all(setting: Setting, data: Path | None, plan: Path | None, only: str | None) -> list[Result]:
    """All worlds that there is data for, telling what is under way."""
    makers: dict[str, Callable[[], list[Result]]] = {
        "loop": lambda: results(loop(seed, spec) for spec in setting.corridors for seed in range(setting.loops)),
        "hall": lambda: results(hall(seed, setting.hall_ticks) for seed in range(setting.halls)),
    }
    plan = plan or (data and data / "willow_garage" / "willow-full.pgm")
    if plan:
        makers["floor"] = lambda: results(floor(plan, seed, setting.floor_ticks) for seed in range(setting.floors))
    if data:
        makers["park"] = lambda: park_results(data / "victoria_park", setting.park_steps)
    run(loop(0, LoopSpec(side=10)), "local maps", "jcbb")  # compiles
    out: list[Result] = []
    for name in WORLDS:
        if only not in (None, name):
            continue
        if name not in makers:
            print(f"{name}: left out, no data (--data or SLAM_GYM_DATA)")
            continue
        start = time.perf_counter()
        out += makers[name]()
        print(f"{name}: {time.perf_counter() - start:.0f} s", flush=True)
    return out


def tables(rows: list[Result]) -> list[tuple[str, list[str], list[list[str]]]]:
    """Title, columns and rows of each table to print."""
    return [
        ("Runs: medians, of ANEES with quartiles", *runs_table(rows)),
        ("Differences from the standard EKF on the same logs", *paired_table(rows)),
    ]


def runs_table(rows: list[Result]) -> Table:
    """World by world, associator by associator, the methods beneath each other."""
    columns = ["world", "association", "method", "runs", "ANEES", "optimistic", "error [m]", "final [m]", "final [°]"]
    out = []
    for world, associator, method, group in _grouped(rows):
        anees = np.percentile([r.anees for r in group], [50, 25, 75])
        shown = [f"{anees[0]:.2f} [{anees[1]:.2f}, {anees[2]:.2f}]", f"{np.mean([r.optimistic for r in group]):.2f}"]
        for name in ("error", "final", "final_degrees", "claimed", "landmarks", "gps"):
            shown.append(f"{np.median([getattr(r, name) for r in group]):.2f}")
        counts = [f"{np.mean([r.duplicates for r in group]):.1f}", f"{np.mean([r.features for r in group]):.0f}"]
        closed = text(sum(r.duplicates < CLOSED for r in group), len(group)) if world.startswith("loop") else ""
        seconds = f"{np.median([r.seconds for r in group]):.2f}"
        out.append([world, associator, method, str(len(group)), *shown, *counts, closed, seconds])
    columns += ["heading σ [°]", "map RMSE [m]", "GPS [m]", "duplicates", "features", "closed", "seconds"]
    return columns, out


def paired_table(rows: list[Result]) -> Table:
    """Interquartile means of the differences, over the seeds."""
    out = []
    for world, associator, method, group in _grouped(rows):
        same = [r for r in rows if (r.world, r.associator, r.method) == (world, associator, METHODS[0])]
        if method == METHODS[0] or len(group) < 3:
            continue
        line = [world, associator, method]
        for figure in _COMPARED.values():
            ours, theirs = (np.array([figure(r) for r in sorted(g, key=lambda r: r.seed)]) for g in (group, same))
            d = paired_difference(ours, theirs, np.random.default_rng(0))
            line.append(f"{d.estimate:+.2f} [{d.low:+.2f}, {d.high:+.2f}]")
        out.append(line)
    return ["world", "association", "method", *_COMPARED], out


def _grouped(rows: list[Result]) -> Iterator[tuple[str, str, str, list[Result]]]:
    for world in dict.fromkeys(r.world for r in rows):
        for associator in ASSOCIATORS:
            for method in METHODS:
                group = [r for r in rows if (r.world, r.associator, r.method) == (world, associator, method)]
                yield world, associator, method, group


def write(rows: list[Result], folder: Path) -> None:
    """One CSV line for each run, and a picture where matplotlib is installed."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "consistency.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    try:
        from slam_gym.bench.consistency import plots as consistency_plots
    except ImportError:
        print("no pictures: matplotlib is not installed")
        return
    consistency_plots.save(rows, folder)


def main(argv: list[str] | None = None) -> None:
    """Print the tables; with --out, write every run and a picture into a folder."""
    parser = argparse.ArgumentParser(prog="python -m slam_gym.bench consistency", description=__doc__)
    parser.add_argument("--data", type=Path, help="folder of the recordings (default: environment SLAM_GYM_DATA)")
    parser.add_argument("--plan", type=Path, help="floor plan image, 0.1 m a pixel (default: Willow Garage in --data)")
    parser.add_argument("--only", choices=WORLDS, help="one of the worlds")
    parser.add_argument("--quick", action="store_true", help="fewer and shorter runs: under a minute")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the CSV file and the picture")
    arguments = parser.parse_args(argv)
    given = arguments.data or os.environ.get("SLAM_GYM_DATA")
    data = Path(given) if given else None
    rows = run_all(QUICK if arguments.quick else FULL, data, arguments.plan, arguments.only)
    if not rows:
        parser.error("nothing was run")
    for table in tables(rows):
        show(*table)
    if arguments.out:
        write(rows, arguments.out)
