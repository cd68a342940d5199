"""Maps of the first test worlds of the drift scenarios: map error, duplicates and lost maps, world by world, as a CSV.

Seven scenarios × JCBB, the learned associator and true association, driven by information gain, with relocation (gcbb)
and the atlas: the conditions of the headline table. With `--compare OLD.csv` a second table has the paired differences
NEW − OLD over the worlds that both hold, with 95 % bootstrap intervals of their mean.

    python benchmarks/drift_reference.py --out new.csv [--compare old.csv]    # some ten minutes on two idle cores

Rows that the CSV has already are not driven again. `--quick` drives 60 ticks of one world.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

import slam_gym  # noqa: F401 (registers the environments)
from agents.drivers.information_gain import InformationGain
from slam_gym.metrics.statistics import mean, paired_difference

SCENARIOS = ("drift-1", "drift-2", "drift-3", "aliased-drift", "hall-drift", "crowd-drift", "loop")
ASSOCIATORS = ("jcbb", "learned", "true_association")
KEYS = ["scenario", "associator", "world"]
MEASURES = ["map_error", "duplicates", "lost"]
LOST_ERROR, LOST_DUPLICATES = 0.8, 10  # a map with more of either is lost

Task = tuple[str, str, int]


def drive(task: Task, **overrides: Any) -> dict[str, Any]:
    """One episode to its end, as a row of the CSV; `overrides` are fields of the scenario to change."""
    scenario, associator, world = task
    env = gym.make(
        "slam_gym/Explore-v0",
        scenario=scenario,
        associator=associator,
        split="test",
        action="goal",
        relocation="gcbb",
        atlas=True,
        overrides=overrides,
        disable_env_checker=True,
    )
    driver = InformationGain()
    start = perf_counter()
    observation, info = env.reset(seed=world, options={"world": world})
    over = False
    while not over:
        observation, _, over, _, info = env.step(driver.act(observation, info))
    error, duplicates = float(info["map_quality"]["map_error"]), int(info["map_quality"]["duplicates"])
    return {
        **dict(zip(KEYS, task)),
        "map_error": error,
        "duplicates": duplicates,
        "lost": int(error > LOST_ERROR or duplicates > LOST_DUPLICATES),
        "seconds": round(perf_counter() - start, 2),
    }


def drive_all(tasks: list[Task], out: Path, jobs: int) -> pd.DataFrame:
    """The rows of all tasks; those that `out` does not have are driven, and written as they are finished."""
    rows = pd.read_csv(out).to_dict("records") if out.exists() else []
    known = {tuple(row[key] for key in KEYS) for row in rows}
    with ProcessPoolExecutor(jobs) as pool:
        for row in pool.map(drive, [task for task in tasks if task not in known]):
            rows.append(row)
            pd.DataFrame(rows).to_csv(out, index=False)
            print(*row.values(), flush=True)
    return pd.DataFrame(rows)


def differences(new: pd.DataFrame, old: pd.DataFrame) -> pd.DataFrame:
    """Mean paired differences NEW − OLD with their intervals, by scenario and associator, and over all scenarios."""
    pairs = new.merge(old, on=KEYS, suffixes=(" new", " old"))
    groups = [*pairs.groupby(["associator", "scenario"], sort=False)]
    groups += [((name, "all"), group) for name, group in pairs.groupby("associator", sort=False)]
    rows = []
    for (associator, scenario), group in groups:
        row: dict[str, Any] = {"associator": associator, "scenario": scenario, "worlds": len(group)}
        for name in MEASURES:
            now, before = (group[f"{name} {which}"].to_numpy(float) for which in ("new", "old"))
            found = paired_difference(now, before, np.random.default_rng(0), statistic=mean)
            row[name] = f"{found.estimate:+.3f} [{found.low:+.3f}, {found.high:+.3f}]"
            row["equal"] = row.get("equal", True) & (now == before)
        row["equal"] = int(row["equal"].sum())
        rows.append(row)
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="CSV to write, or to go on with (default: drift_reference.csv)")
    parser.add_argument("--compare", type=Path, metavar="OLD", help="CSV to print paired differences from")
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS, help="default: all seven")
    parser.add_argument("--associators", nargs="+", default=ASSOCIATORS, help="default: all three")
    parser.add_argument("--worlds", type=int, default=10, help="test worlds 0 … N − 1 (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="60 ticks of drift-2 with JCBB, nothing written")
    a = parser.parse_args()
    if a.quick:
        print(drive(("drift-2", "jcbb", 0), budget=60))
        return
    out = a.out or Path("drift_reference.csv")
    found = drive_all([*product(a.scenarios, a.associators, range(a.worlds))], out, a.jobs)
    print(found.groupby(KEYS[:2], sort=False)[MEASURES].mean().round(3).to_string())
    if a.compare:
        print(f"\n{out} − {a.compare}\n{differences(found, pd.read_csv(a.compare)).to_string(index=False)}")


if __name__ == "__main__":
    main()
