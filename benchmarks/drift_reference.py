"""Maps of the first test worlds of the drift scenarios: map errors, duplicates and lost maps, world by world, as a CSV.

Seven scenarios × JCBB, the learned associator and true association, driven by information gain, with relocation (gcbb)
and the atlas: the conditions of the headline table. The map of the filter is compared with that of batch least squares
with the same pairings, the maximum-likelihood map for them. A drive is sound if its map has an aligned error of at most
0.5 and at most ten duplicates. With `--compare OLD.csv`, a second table contains the paired differences NEW − OLD over
common worlds, with 95 % bootstrap intervals of their mean.

    python benchmarks/drift_reference.py --out new.csv [--compare old.csv]    # some ten minutes on two idle cores

Rows that are in the CSV already are not driven again. `--quick` drives 60 ticks of one world and writes nothing.
"""

from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from agents.drivers.baselines import InformationGain
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.evaluation.mapped_log import final_ids
from agents.evaluation.pipeline import run_all
from benchmarks.common import Record, mean_interval, options, table
from slam_gym import Odometry, Scan, smooth
from slam_gym.geometry import transform
from slam_gym.metrics.map_quality import map_error, map_error_aligned
from slam_gym.simulation.episode import Episode
from slam_gym.types import IntArray

SCENARIOS = ("drift-1", "drift-2", "drift-3", "aliased-drift", "hall-drift", "crowd-drift", "loop")
ASSOCIATORS = ("jcbb", "learned", "true_association")
KEYS = ["scenario", "associator", "world"]
MEASURES = ["map_error", "map_error_aligned", "batch", "batch_aligned", "duplicates", "lost", "missed_loop"]

MOST_ERROR, MOST_DUPLICATES = 0.5, 10  # of a sound map


def drive(scenario: str, associator: str, world: int, **overrides: Any) -> Record:
    """Run one episode; returns its row of the CSV. `overrides` are fields of the scenario to change."""
    driver = InformationGain()
    env = ExploreArguments(scenario, tuple(overrides.items()), associator=associator).make(driver.action)
    steps: list[tuple[Odometry, Scan, IntArray]] = []

    def record_step(env: Any) -> None:
        steps.append((env.episode.odometry, env.episode.scan, env.episode.last_step.ids))

    env.unwrapped.watch(record_step)  # type: ignore[attr-defined]
    result = run_episode(env, driver, world)
    errors = {name: result[name] for name in MEASURES[:2]} | batch_errors(env.unwrapped.episode, steps)  # type: ignore[attr-defined]
    counts = {"lost": int(result["map_lost"])} | {name: int(result[name]) for name in ("duplicates", "missed_loop")}
    return dict(zip(KEYS, (scenario, associator, world))) | errors | counts | {"seconds": round(result["seconds"], 2)}


def batch_errors(episode: Episode, steps: list[tuple[Odometry, Scan, IntArray]]) -> Record:
    """Map error, raw and aligned, of the confirmed features at their positions by batch least squares; NaN where wrong
    pairings keep it from an optimum."""
    odometry, scans, ids = zip(*steps)
    pairings = [final_ids(episode.slam, of_scan) for of_scan in ids]
    try:
        best = smooth(odometry, scans, pairings, np.array(episode.estimates))
    except ValueError as error:
        print(f"no batch solution: {error}")
        return {"batch": float("nan"), "batch_aligned": float("nan")}
    confirmed = np.concatenate([m.ids[~m.provisional] for m in episode.slam.maps])
    mapped = transform(episode.base, best.positions[np.searchsorted(best.ids, confirmed)])
    sigma0, sources = episode.scenario.prior_sigma, episode.identities.majority_of(confirmed)
    known = mapped[sources >= 0], episode.site.plan.features.positions[sources[sources >= 0]]
    aligned = map_error_aligned(mapped, episode.targets, sigma0, known)
    return {"batch": map_error(mapped, episode.targets, sigma0), "batch_aligned": aligned}


def drive_all(tasks: list[tuple[str, str, int]], out: Path, jobs: int) -> pd.DataFrame:
    """The rows of all tasks. Drives those that are not in `out`, and writes each when it is finished."""
    rows: list[Record] = pd.read_csv(out).to_dict("records") if out.exists() else []
    known = {tuple(row[key] for key in KEYS) for row in rows}
    for row in run_all([partial(drive, *task) for task in tasks if task not in known], jobs):
        rows.append(row)
        pd.DataFrame(rows).to_csv(out, index=False)
        print(*row.values(), flush=True)
    return pd.DataFrame(rows).sort_values(KEYS)


def sound(rows: pd.DataFrame) -> str:
    """How many drives have a sound map."""
    good = (rows["map_error_aligned"] <= MOST_ERROR) & (rows["duplicates"] <= MOST_DUPLICATES)
    return f"{good.sum()} of {len(rows)}"


def _mean(values: pd.Series) -> float:
    """The mean, NaN where a drive has no batch solution, so that all columns are over the same drives."""
    return float(values.mean(skipna=False))


def differences(new: pd.DataFrame, old: pd.DataFrame) -> pd.DataFrame:
    """Mean paired differences NEW − OLD with their intervals, by scenario and associator, and over all scenarios."""
    new, old = new.set_index(KEYS).align(old.set_index(KEYS), join="inner")
    measures = [name for name in MEASURES if name in old]  # older files have fewer
    equal = ((new == old) | (new.isna() & old.isna()))[measures].all(axis=1)
    gaps = (new - old)[measures].assign(equal=equal).reset_index()

    def summary(group: pd.DataFrame) -> pd.Series:
        means = {name: mean_interval(group[name], signed=True) for name in measures}
        return pd.Series({"worlds": len(group), **means, "equal": group["equal"].sum()})

    worlds = gaps.groupby(["associator", "world"], sort=False)  # world k may be the same building in several scenarios
    over_all = worlds[measures].agg(_mean).assign(equal=worlds["equal"].sum(), scenario="all").reset_index()
    groups = pd.concat([gaps, over_all]).groupby(["associator", "scenario"], sort=False)
    return groups.apply(summary).reset_index()


if __name__ == "__main__":
    a = options(__doc__, out="drift_reference.csv", compare="", scenarios=SCENARIOS, associators=ASSOCIATORS,
                worlds=10, jobs=2)  # fmt: skip
    if a.quick:
        print(drive("drift-2", "jcbb", 0, budget=60))
        raise SystemExit
    results = drive_all([*product(a.scenarios, a.associators, range(a.worlds))], Path(a.out), a.jobs)
    groups = results.groupby(KEYS[:2], sort=False)
    means = groups[MEASURES].agg(_mean).round(3).join(groups.apply(sound).rename("sound"))
    table("Means over the worlds", means.reset_index())
    if a.compare:
        table(f"{a.out} − {a.compare}", differences(results, pd.read_csv(a.compare)))
