"""Maps of real floors: one drive of each floor and seed, replayed with every associator, as a CSV.

The robot of `building` is driven by information gain with true association. Every associator maps the same drive with
the same odometry and scans, with relocation (gcbb) and the atlas. Rows of one drive therefore differ only by their
decisions.
The columns `batch` are the errors of batch least squares with the same pairings; with the true ones, they are the floor
of the table.

    SLAM_GYM_DATA=... python benchmarks/floors.py --floors 50052750 50010535_PLAN1 --seeds 0 1 --out floors.csv

A floor is a file, or the name of one in the folder `kth_floorplans` of the recordings.
The last table has the mean of each measure over all drives with its 95 % bootstrap interval, and the number of sound
drives, as in `drift_reference.py`.

A drive and associator take ten to forty seconds for floors of 200 m, whose drives end after `--ticks`. Rows that are in
the CSV already are left out. `--quick` drives 60 ticks of the scenario `building` itself and writes nothing.
"""

import os
from pathlib import Path
from typing import Any

import pandas as pd

from agents.demo import mapped, one_drive
from benchmarks.common import Record, mean_interval, options, table
from benchmarks.drift_reference import batch_errors, sound
from slam_gym.recordings import DATA
from slam_gym.simulation.episode import Episode
from slam_gym.simulation.judged import CEILING
from slam_gym.simulation.quality import quality
from slam_gym.slam.relocate import SEARCH
from slam_gym.types import Array

SCENARIO = "building"
SUFFIX = "_occ_map.npy.gz"
ASSOCIATORS = ("jcbb", "marginal", "learned", CEILING)
KEYS = ["floor", "seed", "associator", "ticks"]
MEASURES = ("map_error_aligned", "map_error", "duplicates", "missed_loop", "precision", "recall", "anees")
SUMMARY = ["map_error_aligned", "map_error", "batch_aligned", "batch", "duplicates", "precision", "recall"]


def file_of(floor: str) -> str:
    """The path of a floor plan that is given by its path or by its name among the recordings."""
    named = Path(os.environ.get(DATA, ""), "kth_floorplans", f"{floor}{SUFFIX}")
    return floor if Path(floor).exists() else str(named)


def replayed(arguments: dict[str, Any], seed: int, speeds: Array, associator: str) -> Record:
    """The measures of the map that an associator makes of a drive."""
    steps, lost = [], []

    def record_scan(episode: Episode) -> None:
        steps.append((episode.odometry, episode.scan, episode.last_step.ids))
        lost.append(episode.slam.lost)

    search = None if associator == CEILING else SEARCH
    episode = mapped(SCENARIO, seed, speeds, watch=record_scan, associator=associator, relocation=search, **arguments)
    measures, counts = quality(episode), {"lost_steps": sum(lost), "maps": len(episode.slam.maps)}
    return {name: measures[name] for name in MEASURES} | batch_errors(episode, steps) | counts


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Means with 95 % bootstrap intervals over the drives of each associator, and how many are sound."""
    found = []
    for associator, drives in rows.groupby("associator", sort=False):
        means = {name: mean_interval(drives[name]) for name in SUMMARY}
        found.append({"associator": associator, "sound": sound(drives), **means})
    return pd.DataFrame(found)


if __name__ == "__main__":
    a = options(__doc__, floors=("",), seeds=(0,), associators=ASSOCIATORS, ticks=0, out="")
    out = Path(a.out) if a.out and not a.quick else None
    rows = pd.read_csv(out, dtype={"floor": str}) if out is not None and out.exists() else pd.DataFrame(columns=KEYS)
    done = set(rows[KEYS].itertuples(index=False, name=None))
    ticks = 60 if a.quick else a.ticks
    for floor in a.floors:
        name = Path(floor).name.removesuffix(SUFFIX) or SCENARIO
        arguments: dict[str, Any] = {"split": "test", "overrides": {"budget": ticks} if ticks else {}}
        arguments |= {"floor_plan": file_of(floor), "resolution": 0.1} if floor else {}
        for seed in a.seeds:
            remaining = [associator for associator in a.associators if (name, seed, associator, ticks) not in done]
            if not remaining:
                continue
            speeds = one_drive(SCENARIO, seed, relocation=None, **arguments)
            for associator in remaining:
                row = dict(zip(KEYS, (name, seed, associator, ticks))) | replayed(arguments, seed, speeds, associator)
                rows = pd.concat([rows, pd.DataFrame([row])], ignore_index=True)
                table("", [row])
                if out is not None:
                    rows.to_csv(out, index=False, float_format="%.4f")
    table("All", rows)
    table("Means", summary(rows))
