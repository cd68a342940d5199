"""Associators on recordings: EKF-SLAM over every log with each associator in turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from typer import Option

from agents.evaluation.associators import contenders
from agents.evaluation.mapped_log import map_log, measure, smoothed, write_mapped_log
from agents.evaluation.pipeline import Evaluation, Results, Task
from agents.evaluation.records import Key, Record
from agents.evaluation.tables import Column, Table, by_setting, columns
from slam_gym.recordings.catalogue import open_recordings
from slam_gym.recordings.recording import Recording
from slam_gym.scenarios.registry import slam_for
from slam_gym.simulation.judged import CEILING

COLUMNS = columns(
    "precision", "recall", "f1", "features", "duplicates", "clutter_features", "ate", "ate_batch", "landmark_rmse",
    "landmark_rmse_batch", "anees", "seconds",
)  # fmt: skip
FURTHER_COLUMNS = columns(
    "ate_median", "ate_unaligned", "landmark_rmse_unaligned", "wrong", "clutter_share", "clutter_on_landmarks", "found",
    "nodes", "microseconds", "step_microseconds", "limits",
)  # fmt: skip
CAPTION = """ATE, lm.: RMSE of positions, of landmarks [m], aligned; batch: by batch
least squares with the same pairings; of the true ones, it is the best that could be had.
feat.: confirmed features; dupl.: of a landmark that has one; clut.: of none.
s: time of the whole log."""
FOLDER = "runs"  # of trajectories and maps, within that of the evaluation


@dataclass(frozen=True)
class Recorded:
    """What is done to a recording before it is mapped."""

    data: Annotated[Path | None, Option(help="Recording: its files, by default under SLAM_GYM_DATA.")] = None
    robots: Annotated[list[int] | None, Option(help="Recording: of mrclam, by default all.")] = None
    every: Annotated[int, Option(min=1, help="Recording: only each so many-th scan.")] = 1
    merge: Annotated[float, Option(min=0.0, help="Recording: landmarks no farther apart [m] are one.")] = 0.0
    clean: Annotated[bool, Option("--clean", help="Recording: leave out spurious measurements.")] = False
    reference: Annotated[bool, Option("--reference", help="Recording: vertices of a .g2o are the truth.")] = False

    @property
    def conditions(self) -> dict[str, Any]:
        """What may not change when an evaluation is resumed."""
        return {name: getattr(self, name) for name in ("every", "merge", "clean", "reference")}

    def logs(self, recording: str) -> list[Recording]:
        """All logs that a recording's name stands for, as they are to be mapped.

        Raises as `open_recordings`; ValueError for robots of another recording than mrclam.
        """
        if self.robots and recording != "mrclam":
            raise ValueError(f"--robots is for mrclam, not for {recording}")
        logs = open_recordings(recording, self.data, self.robots, reference=self.reference)
        logs = [log.without_spurious() for log in logs] if self.clean else logs
        logs = [log.merged(self.merge) for log in logs] if self.merge > 0.0 else logs
        return [surveyed(log.every(self.every) if self.every > 1 else log) for log in logs]


def surveyed(log: Recording) -> Recording:
    """The log with the batch solution of its identities for a survey of landmarks, and of the robot, where it has none.

    What the filter and others make of the log is then held against the best that could be made of it.
    """
    if len(log.landmarks) or not (log.sources >= 0).any():
        return log
    best = smoothed(map_log(log, CEILING, slam_for(log)))
    if best is None:
        return log
    known = best.features[best.features["identity"] >= 0]
    ids, places = known["identity"].to_numpy(), np.ascontiguousarray(known[["x", "y"]].to_numpy())
    log = replace(log, landmark_ids=ids, landmarks=places)
    if len(log.reference_times):
        return log
    return replace(log, reference_times=log.times, reference_poses=best.poses * [1.0, 1.0, math.nan])


def map_and_measure(
    log: Recording, associator: str, relocation: str | None, folder: Path, wanted: Sequence[Key]
) -> list[Record]:
    """One log with one associator, and the search that finds a lost robot; trajectory and map go into a folder."""
    mapped = map_log(log, associator, slam_for(log), relocation)
    write_mapped_log(folder, wanted[0].name, mapped)
    return [wanted[0]._asdict() | {"source": log.source} | measure(mapped)]


def recording_evaluation(
    associators: Sequence[str],
    logs: Sequence[Recording],
    conditions: dict[str, Any],
    out: Path,
    relocations: Sequence[str | None],
) -> Evaluation:
    """Every associator with every relocation on every log, checked; files go into a folder of `out`.

    ValueError for an associator or a relocator that nobody knows.
    """
    tasks = [
        Task((Key(name, log.name, 0),), partial(map_and_measure, log, *searches, out / FOLDER))
        for log in logs
        for name, searches in contenders(associators, relocations).items()
    ]
    settings = {log.name: asdict(slam_for(log)) for log in logs}
    return Evaluation("recordings", tasks, conditions | {"relocation": list(relocations)}, {"settings": settings})


def means(frame: pd.DataFrame) -> pd.DataFrame:
    """Of each associator that was run over all logs, in the order of the frame; one row each."""
    groups = frame.groupby("name", sort=False)
    found = groups[[column.key for column in (*COLUMNS, *FURTHER_COLUMNS)]].mean()
    return found[groups["setting"].nunique() == frame["setting"].nunique()].reset_index()


def table(frame: pd.DataFrame, shown: Sequence[Column], title: str = "", caption: str = "") -> Table:
    """Of one log, or of the means, with the columns in which there is anything."""
    kept = [column for column in shown if frame[column.key].notna().any()]
    rows = frame.set_index("name")[[column.key for column in kept]].astype(float).to_dict("index")
    return Table(title, "associator", kept, rows, caption)


def tables(results: Results) -> list[Table]:
    """One table a log, and that of their means where there are several."""
    frames = {
        f"{name}, {own['steps'].iloc[0]} scans, {own['true_features'].iloc[0]} labelled features": own
        for name, own in by_setting(results.frame).items()
    }
    if len(frames) > 1:
        frames["mean"] = means(results.frame)
    found = [table(own, COLUMNS, title) for title, own in frames.items()]
    return [*found[:-1], replace(found[-1], caption=CAPTION)]
