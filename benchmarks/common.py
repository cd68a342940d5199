"""What the benchmarks share: options, tables, timing, sensing of points in the open, and judged relocations."""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binomtest
from threadpoolctl import threadpool_limits

from slam_gym import Landmarks, Locality, Scan
from slam_gym.geometry import observe, wrap_angle
from slam_gym.types import Array, IntArray, Relocation, Relocator

Record = dict[str, Any]


def options(about: str | None, **defaults: Any) -> argparse.Namespace:
    """The command line: `--quick`, `--seed`, and an option for each default, a list for a tuple.

    BLAS is kept to one thread from here on: on two, small products take 10 to 100 times as long.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few and small: seconds, and no figures worth quoting")
    parser.add_argument("--seed", type=int, default=0, help="of everything random (default: %(default)s)")
    for name, default in defaults.items():
        many = isinstance(default, tuple)
        kind = type(default[0] if many else default)
        parser.add_argument(f"--{name}", default=default, type=kind, nargs="+" if many else None, help=f"{default}")
    threadpool_limits(1)
    return parser.parse_args()


def table(title: str, rows: Sequence[Record] | pd.DataFrame) -> None:
    """Print rows as a table, numbers to four digits."""
    text = pd.DataFrame(rows).to_string(index=False, float_format="{:.4g}".format, na_rep="")
    print(f"\n{title}\n{text}", flush=True)


def data_folder() -> Path | None:
    """Where the recordings are (SLAM_GYM_DATA); None, and a line that says so, where nothing tells."""
    if not os.environ.get("SLAM_GYM_DATA"):
        print("left out: no recordings (SLAM_GYM_DATA)")
        return None
    return Path(os.environ["SLAM_GYM_DATA"])


# -- timing ----------------------------------------------------------------------------------------------------------


def timed(
    call: Callable[..., Any], *arguments: Any, clock: Callable[[], int] = time.thread_time_ns
) -> tuple[Any, float]:
    """What a call returned, and the time that it took [µs], by default of the processor in this thread."""
    start = clock()
    answer = call(*arguments)
    return answer, 1e-3 * (clock() - start)


def fastest(call: Callable[..., Any], *arguments: Any, repeats: int = 5) -> float:
    """Least time [µs] of so many calls: whatever else the machine does only adds."""
    return min(timed(call, *arguments)[1] for _ in range(repeats))


def resident() -> float:
    """[MB] of memory that this process holds; NaN where the system does not tell."""
    statm = Path("/proc/self/statm")
    return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6 if statm.exists() else math.nan


# -- sensing ---------------------------------------------------------------------------------------------------------


def features_in_view(features: Array, pose: Array, reach: float, field_of_view: float = math.tau) -> IntArray:
    """Rows of `features` (n, 2) [m] within `reach` [m] of a pose (3,) and half a `field_of_view` [rad] of ahead."""
    near = np.flatnonzero(np.abs(features - pose[:2]).max(axis=1, initial=0.0) <= reach)
    local = observe(pose, np.ascontiguousarray(features[near]))
    ahead = np.abs(np.arctan2(local[:, 1], local[:, 0])) <= 0.5 * field_of_view
    return near[ahead & (np.hypot(local[:, 0], local[:, 1]) <= reach)]


def clutter(count: int, reach: float, field_of_view: float, rng: np.random.Generator) -> Array:
    """Points (count, 2) [m] in the robot frame, uniform over what the sensor has in view."""
    radius = reach * np.sqrt(rng.random(count))
    bearing = rng.uniform(-0.5 * field_of_view, 0.5 * field_of_view, count)
    return np.column_stack([radius * np.cos(bearing), radius * np.sin(bearing)])


def lanes(side: float, between: float, step: float) -> Array:
    """Poses (w, 3) of a drive there and back over a square, all facing along +x."""
    across, along = np.arange(min(between, side) / 2.0, side, between), np.arange(0.0, side, step)
    return np.array([(x, y, 0.0) for k, y in enumerate(across) for x in along[:: 1 if k % 2 == 0 else -1]])


# -- relocation ------------------------------------------------------------------------------------------------------


class Tolerance(NamedTuple):
    """How far a pose may be off and still be right."""

    metres: float
    radians: float

    def holds(self, found: Array, true: Array) -> bool:
        """Whether the pose `found` (3,) is right; never where one of them is NaN."""
        off = found - true
        return math.hypot(off[0], off[1]) < self.metres and abs(wrap_angle(float(off[2]))) < self.radians


def attempt(
    search: Relocator, scan: Scan, landmarks: Landmarks, locality: Locality | None
) -> tuple[Relocation, Record]:
    """Relocate one scan: the answer, and what it took."""
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


def count_answers(tried: pd.DataFrame, asked: int | None) -> Record:
    """What came of scans when `asked` pairings are asked for (None: what the search itself accepts).

    Rows say whether a scan is from `inside` the map and whether the pose is `right`; outside, every answer is wrong.
    """
    given = tried["accepted"] if asked is None else tried["pairings"] >= asked
    inside, right = tried["inside"].astype(bool), tried["right"].astype(bool)
    counts = [int(which.sum()) for which in (inside & given & right, inside & given & ~right, ~inside & given)]
    scans, strangers = int(inside.sum()), int((~inside).sum())
    return {
        "asked": "the rule" if asked is None else f"≥ {asked}",
        "right": counts[0],
        "wrong": counts[1],
        "none": scans - counts[0] - counts[1],
        "outside: wrong": counts[2],
        "wrong of outside": proportion(counts[2], strangers),
    }


def proportion(count: int, total: int) -> str:
    """`count` of `total` with the exact (Clopper–Pearson) 95 % interval."""
    if total == 0:
        return ""
    interval = binomtest(count, total).proportion_ci()
    return f"{count / total:.3f} [{interval.low:.3f}, {interval.high:.3f}]"
