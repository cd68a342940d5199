"""Maps of real floors: one drive of each floor and seed, replayed with every associator, as a CSV.

The robot of `building` is driven by information gain with true association. Its measurements are recorded, and every
associator maps them, with relocation (gcbb) and the atlas. Rows of one drive therefore differ only by their decisions.
The columns `batch` are the errors of batch least squares with the same pairings; with the true ones, they are the floor
of the table.

    python benchmarks/floors.py --floors A_occ_map.npy.gz B_occ_map.npy.gz --seeds 0 1 --out floors.csv

The last table has the mean of each measure over all drives with its 95 % bootstrap interval, and the number of sound
drives, as in `drift_reference.py`.

A drive and associator take ten to forty seconds for floors of 200 m, whose drives end after `--ticks`. Rows that are in
the CSV already are left out. `--quick` drives 60 ticks of the scenario `building` itself and writes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from agents.drivers.baselines import InformationGain
from agents.evaluation.episodes import ExploreArguments, run_episode
from benchmarks.common import Record, options, table
from benchmarks.drift_reference import batch_errors, sound
from slam_gym import Odometry, Scan
from slam_gym.metrics.statistics import bootstrap_interval, mean
from slam_gym.scenarios import SPLITS
from slam_gym.simulation.episode import Episode
from slam_gym.simulation.judged import CEILING
from slam_gym.simulation.quality import quality
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.relocate import SEARCH, relocate_by
from slam_gym.types import Beams, Truth
from slam_gym.world.physics import Motion

ASSOCIATORS = ("jcbb", "marginal", "learned", CEILING)
KEYS = ["floor", "seed", "associator"]
MEASURES = ("map_error_aligned", "map_error", "duplicates", "missed_loop", "precision", "recall", "anees")
SUMMARY = ["map_error_aligned", "map_error", "batch_aligned", "batch", "duplicates", "precision", "recall"]


class Measured(NamedTuple):
    """The measurements of one tick."""

    odometry: Odometry
    scan: Scan
    truth: Truth
    beams: Beams


class Replay(Episode):
    """An episode with the measurements of another one."""

    def __init__(self, recorded: Iterable[Measured], driven: Episode, seed: int, associator: str) -> None:
        self._recorded = iter(recorded)
        rng = np.random.default_rng(seed)
        rng.integers(SPLITS["test"][1])  # as the environment draws a world, so that the start is the same
        informed = associator == CEILING
        relocate, atlas = (None, None) if informed else (relocate_by(SEARCH), AtlasSpec())
        super().__init__(driven.scenario, driven.site, associator, rng, relocate=relocate, atlas=atlas)
        assert (self.base == driven.base).all()

    def _drive(self, forward: float, turn: float) -> None:
        self.odometry, self.scan, self.truth, self.beams = next(self._recorded)

    def _sense(self, motion: Motion) -> None:
        self._drive(0.0, 0.0)


def drive(floor: str | None, seed: int, ticks: int) -> tuple[list[Measured], Episode]:
    """The measurements of a drive with true association, and its episode. Without a floor, in a world of `building`."""
    driver, recorded = InformationGain(), []
    overrides, resolution = (("budget", ticks),) if ticks else (), 0.1 if floor else None
    arguments = ExploreArguments(
        "building", overrides, associator=CEILING, floor_plan=floor, resolution=resolution, relocation=None
    )
    env = arguments.make(driver.action)

    def record_tick(env: object) -> None:
        episode = env.episode  # type: ignore[attr-defined]
        recorded.append(Measured(episode.odometry, episode.scan, episode.truth, episode.beams))

    env.unwrapped.watch(record_tick)  # type: ignore[attr-defined]
    run_episode(env, driver, seed)
    return recorded, env.unwrapped.episode  # type: ignore[attr-defined]


def replayed(recorded: list[Measured], driven: Episode, seed: int, associator: str) -> Record:
    """The measures of the map that an associator makes of the measurements."""
    episode = Replay(recorded, driven, seed, associator)
    lost, steps = 0, [(episode.odometry, episode.scan, episode.last_step.ids)]
    while episode.ticks < len(recorded) - 1:
        episode.tick(0.0, 0.0)
        lost += episode.slam.lost
        steps.append((episode.odometry, episode.scan, episode.last_step.ids))
    measures, counts = quality(episode), {"lost": lost, "maps": len(episode.slam.maps)}
    return {name: measures[name] for name in MEASURES} | batch_errors(episode, steps) | counts


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Means with 95 % bootstrap intervals over the drives of each associator, and how many are sound."""
    found = []
    for associator, drives in rows.groupby("associator", sort=False):
        row = {"associator": associator, "sound": sound(drives)}
        for name in SUMMARY:
            interval = bootstrap_interval(drives[name].dropna().to_numpy(), np.random.default_rng(0), statistic=mean)
            row[name] = f"{interval.estimate:.3f} [{interval.low:.3f}, {interval.high:.3f}]"
        found.append(row)
    return pd.DataFrame(found)


def main() -> None:
    a = options(__doc__, floors=("",), seeds=(0,), associators=ASSOCIATORS, ticks=0, out="")
    out = Path(a.out) if a.out and not a.quick else None
    rows = pd.read_csv(out) if out is not None and out.exists() else pd.DataFrame(columns=KEYS)
    done = set(rows[KEYS].itertuples(index=False, name=None))
    for floor in a.floors:
        name = Path(floor).name.removesuffix("_occ_map.npy.gz") or "building"
        for seed in a.seeds:
            remaining = [associator for associator in a.associators if (name, seed, associator) not in done]
            if not remaining:
                continue
            recorded, driven = drive(floor or None, seed, 60 if a.quick else a.ticks)
            for associator in remaining:
                row = dict(zip(KEYS, (name, seed, associator))) | replayed(recorded, driven, seed, associator)
                rows = pd.concat([rows, pd.DataFrame([row])], ignore_index=True)
                table("", [row])
                if out is not None:
                    rows.to_csv(out, index=False, float_format="%.4f")
    table("All", rows)
    table("Means", summary(rows))


if __name__ == "__main__":
    main()
