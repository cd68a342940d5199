"""Shared code of the benchmarks: options, tables, recordings, timing, a drive in lanes, and judged relocations."""

import argparse
import math
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest
from threadpoolctl import threadpool_limits

from agents.evaluation.tables import cell, estimate
from slam_gym import Landmarks, Locality, Scan
from slam_gym.metrics.statistics import mean
from slam_gym.recordings import DATA, Recording, open_recordings
from slam_gym.types import Array, Relocation, Relocator

Record = dict[str, Any]


def options(about: str | None, **defaults: Any) -> argparse.Namespace:
    """Parse the command line: `--quick`, and an option for each of `defaults`, a list for a tuple.

    Also limits BLAS to one thread, since on two threads small products take 10 to 100 times as long.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--quick", action="store_true", help="a few small problems, to try the script; its figures mean nothing"
    )
    for name, default in defaults.items():
        many = isinstance(default, tuple)
        kind = type(default[0] if many else default)
        parser.add_argument(f"--{name}", default=default, type=kind, nargs="+" if many else None, help=f"{default}")
    threadpool_limits(1)
    return parser.parse_args()


def table(title: str, rows: Sequence[Record] | pd.DataFrame) -> None:
    """Print rows as a table, with numbers of four digits."""
    text = pd.DataFrame(rows).to_string(index=False, float_format="{:.4g}".format, na_rep="")
    print(f"\n{title}\n{text}", flush=True)


def published(name: str) -> Recording | None:
    """A published recording. If SLAM_GYM_DATA, the folder of the recordings, is not set, prints so and returns None."""
    if not os.environ.get(DATA):
        print(f"left out: no recordings ({DATA})")
        return None
    return open_recordings(name)[0]


def timed(call: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """The result of a call, and the CPU time [µs] of this thread."""
    start = time.thread_time_ns()
    answer = call(*arguments)
    return answer, 1e-3 * (time.thread_time_ns() - start)


def fastest(call: Callable[..., Any], *arguments: Any, repeats: int = 5) -> float:
    """The least time [µs] of `repeats` calls, since other load of the machine only adds time."""
    return min(timed(call, *arguments)[1] for _ in range(repeats))


def resident() -> float:
    """Resident memory [MB] of this process; NaN where the system does not report it."""
    statm = Path("/proc/self/statm")
    return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6 if statm.exists() else math.nan


def lanes(side: float, between: float, step: float) -> Array:
    """Poses (w, 3) of a drive in lanes over a square, all with heading 0."""
    across, along = np.arange(min(between, side) / 2.0, side, between), np.arange(0.0, side, step)
    return np.array([(x, y, 0.0) for k, y in enumerate(across) for x in along[:: 1 if k % 2 == 0 else -1]])


def attempt(
    search: Relocator, scan: Scan, landmarks: Landmarks, locality: Locality | None
) -> tuple[Relocation, Record]:
    """Relocate one scan; returns the answer, and a record of it with its effort."""
    answer, microseconds = timed(search, scan, landmarks, locality)
    effort = answer.effort
    return answer, {
        "pairings": answer.pairings,
        "accepted": answer.accepted,
        "nodes": effort.nodes,
        "pairing tests": effort.unary_tests + effort.binary_tests,
        "limit hit": effort.limit_hit,
        "ms": 1e-3 * microseconds,
    }


def count_answers(attempts: pd.DataFrame, required: int | None) -> Record:
    """The outcomes of scans if `required` pairings are required (None: those that the search itself accepts).

    Rows say whether a scan is from `inside` the map and whether the pose is `right`; outside, every answer is wrong.
    """
    answered = attempts["accepted"] if required is None else attempts["pairings"] >= required
    inside, right = attempts["inside"].astype(bool), attempts["right"].astype(bool)
    outcomes = {"right": inside & answered & right, "wrong": inside & answered & ~right, "none": inside & ~answered,
                "outside: wrong": ~inside & answered}  # fmt: skip
    counts = {name: int(rows.sum()) for name, rows in outcomes.items()}
    share = proportion(counts["outside: wrong"], int((~inside).sum()))
    return {"asked": "the rule" if required is None else f"≥ {required}", **counts, "wrong of outside": share}


def mean_interval(values: Any, signed: bool = False) -> str:
    """The mean of values (n,) as text, with the interval that `estimate` has for them; `signed` for differences."""
    middle, interval = cell(estimate(values, statistic=mean), 3, signed)
    return f"{middle} [{interval}]" if interval else middle


def proportion(count: int, total: int) -> str:
    """`count` of `total` with the exact (Clopper–Pearson) 95 % interval."""
    if total == 0:
        return ""
    interval = binomtest(count, total).proportion_ci()
    return f"{count / total:.3f} [{interval.low:.3f}, {interval.high:.3f}]"
