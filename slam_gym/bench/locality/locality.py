"""What locality saves relocation, against the bound of the source, and what it costs.

Equation 9.22 counted hypothesis by hypothesis; effort of GCBB and of random sampling (RS) against the size of the map
and the number of measurements, under each locality; what each locality loses; how many pairings make an answer
believable. The axes are those of reference experiment B (`locality_worlds`): .02 features per m², range 15 m, 180°, one
lawn-mower pass, a quarter of the measurements spurious, sizes and kinds unknown. Pairing tests are unary and binary
ones. GCBB is run as in the source for the effort, with the search for rivals where answers are judged.

With --tracking: what covisibility saves JCBB in exploration, where a prior on the pose has gated the candidates.
"""

from __future__ import annotations

import argparse
import csv
import functools
import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.association.relocation.random_sampling import random_sampling
from slam_gym.bench.locality import tracking as locality_tracking
from slam_gym.bench.locality.acceptance import Outcome, gather, outcomes
from slam_gym.bench.locality.bound import verify
from slam_gym.bench.locality.sweep import MEASURES, Cell, Plan, Reach, as_it_came, sweep
from slam_gym.bench.locality.tables import JUDGED, Results, Size, show, tables
from slam_gym.bench.locality.worlds import LOCALITIES, from_centre
from slam_gym.types import Relocator

SEARCHED = tuple(name for name in LOCALITIES if name != "joined maps")  # its loss is shown; nobody would search it


FULL = Size((50, 100, 200, 400, 800, 1600, 3200, 6400, 12800), (4, 6, 8, 10, 12, 14, 16), 400, 30, 1.1e9, 500)
QUICK = Size((50, 100, 200, 400, 800, 1600), (4, 6, 8), 200, 6, 2.2e8, 30)


def searches(confidence: float = 0.99, *, rivals: bool = False) -> dict[str, Relocator]:
    """GCBB, with or without the search for rivals, and RS, by the names they have in the tables."""
    return {
        "GCBB": functools.partial(gcbb, confidence=confidence, rivals=rivals),
        "RS": functools.partial(random_sampling, confidence=confidence),
    }


def effort_against_map(size: Size, m: int, seed: int) -> tuple[list[Cell], list[Reach]]:
    """The sweep over n. A cell takes n times what it took before under a locality, n² times without."""
    plan = Plan(searches(), SEARCHED, size.scans, seed, size.tests)
    n = size.maps
    return sweep(plan, [(k, m) for k in n], lambda name, a, b: (n[b] / n[a]) ** (2.0 if name == "everything" else 1.0))


def effort_against_measurements(size: Size, seed: int) -> tuple[list[Cell], list[Reach]]:
    """The sweep over m in maps of `size.fixed` features."""
    plan = Plan(searches(), SEARCHED, size.scans, seed, size.tests)
    m = size.measurements
    return sweep(plan, [(size.fixed, k) for k in m], lambda _, a, b: 1.7 ** (m[b] - m[a]))


def effect_of_settings(size: Size, m: int, seed: int) -> list[tuple[str, Cell]]:
    """Gates of .95 and .99, and measurements taken from the centre of the scan outwards, on the same scans."""
    out = []
    for label, confidence, arrange in (
        ("gates of .95", 0.95, as_it_came),
        ("gates of .99", 0.99, as_it_came),
        ("from the centre", 0.99, from_centre),
    ):
        names, scans = ("covisibility", "two hops", "everything"), 4 * size.scans
        plan = Plan(searches(confidence), names, scans, seed, size.tests, arrange=arrange)
        cells, _ = sweep(plan, [(size.fixed, m)], lambda *_: 1.0)
        out += [(label, cell) for cell in cells]
    return out


def judge(size: Size, seed: int) -> dict[tuple[str, int], list[Outcome]]:
    """Right, wrong and no answer by search and m."""
    return {
        (name, m): outcomes(*gather(name, search, m, 400, size.judged, seed, JUDGED))
        for m in size.judged_measurements
        for name, search in searches(rivals=True).items()
    }


def run(size: Size, m: int = 8, seed: int = 0) -> Results:
    """Everything, telling what is under way."""
    results = Results(size, m)
    _compile(seed)
    for name, part in (
        ("bound", lambda: verify(np.random.default_rng(seed))),
        ("maps", lambda: effort_against_map(size, m, seed)),
        ("measurements", lambda: effort_against_measurements(size, seed)),
        ("settings", lambda: effect_of_settings(size, m, seed)),
        ("answers", lambda: judge(size, seed)),
    ):
        start = time.perf_counter()
        setattr(results, name, part())
        print(f"{name}: {time.perf_counter() - start:.0f} s", flush=True)
    return results


def _compile(seed: int) -> None:
    """Once through all kernels, so that no timing holds their compilation."""
    sweep(Plan(searches(), SEARCHED, 2, seed, math.inf), [(50, 6)], lambda *_: 1.0)


def write(results: Results, folder: Path) -> None:
    """CSV files of everything, and pictures where matplotlib is installed."""
    folder.mkdir(parents=True, exist_ok=True)
    for title, rows in (
        ("bound", results.bound),
        ("localities", [asdict(reach) for reach in results.maps[1]]),
        ("localities_by_m", [asdict(reach) for reach in results.measurements[1]]),
        ("map_size", [_row(cell) for cell in results.maps[0]]),
        ("measurements", [_row(cell) for cell in results.measurements[0]]),
        ("settings", [{"setting": label, **_row(cell)} for label, cell in results.settings]),
        ("answers", [{"search": s, "m": m, **asdict(o)} for (s, m), found in results.answers.items() for o in found]),
    ):
        with (folder / f"{title}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    try:
        from slam_gym.bench.locality import plots as locality_plots
    except ImportError:
        print("no pictures: matplotlib is not installed")
        return
    locality_plots.save(results, folder)


def _row(cell: Cell) -> dict[str, Any]:
    means = {name: cell.mean(name) for name in MEASURES}
    return {"search": cell.search, "locality": cell.locality, "n": cell.n, "m": cell.m, "scans": len(cell), **means}


def main(argv: list[str] | None = None) -> None:
    """Print the tables; with --out, write them and pictures into a folder."""
    parser = argparse.ArgumentParser(prog="python -m slam_gym.bench locality", description=__doc__)
    parser.add_argument("--tracking", action="store_true", help="the other benchmark: JCBB while tracking")
    parser.add_argument("--quick", action="store_true", help="smaller maps, fewer scans: under a minute")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for CSV files and pictures")
    parser.add_argument("--seed", type=int, default=0)
    arguments, rest = parser.parse_known_args(argv)
    if arguments.tracking:
        locality_tracking.main(rest)
        return
    if rest:
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    results = run(QUICK if arguments.quick else FULL, seed=arguments.seed)
    for table in tables(results):
        show(*table)
    if arguments.out:
        write(results, arguments.out)
