"""Associators on recordings: EKF-SLAM over every log with each associator in turn."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import pandas as pd

from agents.evaluation.associators import contenders
from agents.evaluation.mapped_log import map_log, measure, write_mapped_log
from agents.evaluation.pipeline import Evaluation, Results
from agents.evaluation.records import Key, Record
from agents.evaluation.tables import Column, Table, by_setting
from slam_gym.recordings.catalogue import open_recordings
from slam_gym.recordings.recording import Recording
from slam_gym.scenarios.registry import slam_for

COLUMNS = (
    Column("precision", "prec.", 3, "higher"),
    Column("recall", "recall", 3, "higher"),
    Column("f1", "F1", 3, "higher", optional=True),
    Column("features", "feat.", 0),
    Column("duplicates", "dupl.", 0, "lower"),
    Column("clutter_features", "clut.", 0, "lower"),
    Column("ate", "ATE", 2, "lower"),
    Column("ate_unaligned", "ATE₀", 2, "lower"),
    Column("landmark_rmse", "lm.", 2, "lower"),
    Column("anees", "ANEES", 1),
    Column("seconds", "s", 1, "lower", optional=True),
)
FURTHER_COLUMNS = (
    Column("ate_median", "median error", 2, "lower"),
    Column("landmark_rmse_unaligned", "landmarks₀", 2, "lower"),
    Column("wrong", "wrong", 0, "lower"),
    Column("clutter_share", "clutter accepted", 3, "lower"),
    Column("clutter_on_landmarks", "onto landmarks", 0, "lower"),
    Column("found", "found", 0, "higher"),
    Column("nodes", "nodes", 0),
    Column("microseconds", "µs/scan", 0, "lower"),
    Column("step_microseconds", "µs/step", 0, "lower"),
    Column("limits", "limit met", 0, "lower"),
)
CAPTION = """ATE, lm.: RMSE of positions, of landmarks [m], aligned; ATE₀: not aligned.
feat.: confirmed features; dupl.: of a landmark that has one; clut.: of none.
s: time of the whole log."""
FOLDER = "runs"  # of trajectories and maps, within that of the evaluation


@dataclass(frozen=True)
class Log:
    """Which log, and what is done to it before it is mapped."""

    recording: str  # a name or a file
    data: str | None = None  # folder of the published files
    robot: int | None = None  # of MR.CLAM
    position: int = 0  # among the logs that the name stands for
    reference: bool = False  # the vertices of a .g2o file are the truth
    every: int = 1
    merge: float = 0.0  # [m]
    clean: bool = False  # spurious measurements are left out

    def open(self) -> Recording:
        """The log. Raises as `open_recordings`."""
        return _opened(self)


@functools.lru_cache(maxsize=5)
def _opened(log: Log) -> Recording:
    robots = None if log.robot is None else [log.robot]
    recording = open_recordings(log.recording, log.data, robots, reference=log.reference)[log.position]
    recording = recording.without_spurious() if log.clean else recording
    recording = recording.merged(log.merge) if log.merge > 0.0 else recording
    return recording.every(log.every) if log.every > 1 else recording


def logs_of(template: Log, robots: Sequence[int] | None = None) -> dict[str, Log]:
    """All logs that a recording's name stands for, or those of some robots, by their names. Raises as
    `open_recordings`; ValueError for robots of another recording than mrclam."""
    if robots and template.recording != "mrclam":
        raise ValueError(f"--robots is for mrclam, not for {template.recording}")
    found: dict[str, Log] = {}
    for robot in robots or [None]:
        wanted = None if robot is None else [robot]
        opened = open_recordings(template.recording, template.data, wanted, reference=template.reference)
        for position, recording in enumerate(opened):
            found[recording.name] = replace(template, robot=robot, position=position)
    return found


@dataclass(frozen=True)
class LogTask:
    """One log with one associator."""

    associator: str
    log: Log
    setting: str  # name of the log
    relocation: str | None  # the search that finds a lost robot
    name: str  # of the associator, with its relocation where there are several
    folder: Path  # for trajectory and map

    @property
    def keys(self) -> tuple[Key, ...]:
        return (Key(self.name, self.setting, 0),)

    def run(self, wanted: Sequence[Key]) -> list[Record]:
        log = self.log.open()
        mapped = map_log(log, self.associator, slam_for(log), self.relocation)
        write_mapped_log(self.folder, self.name, mapped)
        return [key._asdict() | {"source": log.source} | measure(mapped) for key in wanted]


def recording_evaluation(
    associators: Sequence[str], logs: dict[str, Log], out: Path, relocations: Sequence[str | None]
) -> Evaluation:
    """Every associator with every relocation on every log, checked; files go into a folder of `out`.

    ValueError for an associator or a relocator that nobody knows.
    """
    tasks = [
        LogTask(associator, log, setting, relocation, name, out / FOLDER)
        for setting, log in logs.items()
        for name, (associator, relocation) in contenders(associators, relocations).items()
    ]
    first = asdict(next(iter(logs.values())))
    conditions = {name: first[name] for name in ("recording", "every", "merge", "clean", "reference")}
    conditions["relocation"] = list(relocations)
    settings = {setting: asdict(slam_for(log.open())) for setting, log in logs.items()}
    return Evaluation("recordings", tasks, conditions, {"settings": settings})


def means(frame: pd.DataFrame) -> pd.DataFrame:
    """Of each associator that was run over all logs, in the order of the frame; one row each."""
    numbers = [column.key for column in (*COLUMNS, *FURTHER_COLUMNS)]
    groups = frame.groupby("name", sort=False)
    found = groups[numbers].mean()[groups["setting"].nunique() == frame["setting"].nunique()]
    return found.reset_index()


def table(frame: pd.DataFrame, columns: Sequence[Column], title: str = "", caption: str = "") -> Table:
    """Of one log, or of the means, with the columns in which there is anything."""
    rows = {str(row["name"]): {c.key: float(row[c.key]) for c in columns} for row in frame.to_dict("records")}
    return Table(title, "associator", [c for c in columns if frame[c.key].notna().any()], rows, caption)


def tables(results: Results) -> list[Table]:
    """One table a log, and that of their means where there are several."""
    logs = by_setting(results.frame)
    found = []
    for setting, own in logs.items():
        about = f"{setting}, {own['steps'].iloc[0]} scans, {own['true_features'].iloc[0]} labelled features"
        found.append(table(own, COLUMNS, about))
    if len(logs) > 1:
        found.append(table(means(results.frame), COLUMNS, "mean"))
    return [*found[:-1], replace(found[-1], caption=CAPTION)]
