"""Associators on recordings: one run over one log each, with their tables."""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from agents.evaluation.associators import CEILING, Key, Task, carry_out, find_associator, shipped, short
from agents.evaluation.recording_files import write_run
from agents.evaluation.recording_measures import measure
from agents.evaluation.recording_run import run
from agents.evaluation.results import Column, Record
from slam_gym.recordings.catalogue import PUBLISHED, open_recordings
from slam_gym.recordings.recording import Recording
from slam_gym.scenarios.recorded import slam_for

COLUMNS = (
    Column("precision", "prec.", 3, "higher"),
    Column("recall", "recall", 3, "higher"),
    Column("f1", "F1", 3, "higher"),
    Column("features", "feat.", 0),
    Column("duplicates", "dupl.", 0, "lower"),
    Column("clutter_features", "clut.", 0, "lower"),
    Column("ate", "ATE", 2, "lower"),
    Column("ate_unaligned", "ATE₀", 2, "lower"),
    Column("landmark_rmse", "lm.", 2, "lower"),
    Column("anees", "ANEES", 1),
    Column("seconds", "s", 1, "lower"),
)
MORE = (
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


@dataclass(frozen=True)
class Log:
    """Which log, and what is done to it before it is run."""

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


@dataclass(frozen=True)
class RecordingRun:
    """One associator on one log."""

    associator: str
    log: Log
    setting: str  # name of the log
    folder: Path | None = None  # for trajectory and map

    @property
    def keys(self) -> tuple[Key, ...]:
        return ((self.associator, self.setting, 0),)

    def without(self, done: set[Key]) -> Task | None:
        return None if self.keys[0] in done else self

    def run(self) -> list[Record]:
        log = self.log.open()
        done = run(log, self.associator, slam_for(log))
        record: Record = {"associator": self.associator, "setting": self.setting, "episode": 0}
        record |= {"source": log.source, "landmarks": log.landmarks.tolist()} | measure(log, done)
        if self.folder is not None:
            align = np.array([record["align_x"], record["align_y"], record["align_heading"]])
            write_run(self.folder, log, self.associator, done, align)
        return [record]


def logs_of(a: argparse.Namespace) -> dict[str, Log]:
    """The logs that the options ask for, by name. Raises as `open_recordings`."""
    found: dict[str, Log] = {}
    data = None if a.data is None else str(a.data)
    robots: Sequence[int | None] = a.robots or [None]
    if a.robots and a.recording != "mrclam":
        raise ValueError(f"--robots is for mrclam, not for {a.recording}")
    for robot in robots:
        opened = open_recordings(a.recording, data, None if robot is None else [robot], reference=a.reference)
        for position, recording in enumerate(opened):
            found[recording.name] = Log(a.recording, data, robot, position, a.reference, a.every, a.merge, a.clean)
    return found


def tables(records: Sequence[Record], names: Sequence[str]) -> dict[str, dict[str, dict[str, float]]]:
    """Log → associator → column → number; `mean` over the logs where there are several."""
    columns, settings = (*COLUMNS, *MORE), list(dict.fromkeys(record["setting"] for record in records))
    rows = {(r["setting"], r["associator"]): {c.key: float(r[c.key]) for c in columns} for r in records}
    out = {setting: {name: rows[setting, name] for name in names if (setting, name) in rows} for setting in settings}
    if len(settings) > 1:
        full = [name for name in names if all(name in out[setting] for setting in settings)]
        out["mean"] = {
            name: {c.key: float(np.mean([out[setting][name][c.key] for setting in settings])) for c in columns}
            for name in full
        }
    return out


def text(value: float | None, digits: int) -> str:
    """A number as tables have it; a dash where nothing was measured."""
    if value is None or not math.isfinite(value):
        return "–" if value is None or math.isnan(value) else "∞"
    return f"{value:.{digits}f}" if abs(value) < 1e4 else f"{value:.0e}"


def shown_columns(rows: dict[str, dict[str, float]], columns: Sequence[Column] = COLUMNS) -> list[Column]:
    """Those in which there is anything."""
    return [c for c in columns if any(not math.isnan(row[c.key]) for row in rows.values())]


_NARROW = ("f1", "seconds")  # columns that 80 characters have no room for beside those about the truth


def show(table: dict[str, dict[str, dict[str, float]]], records: Sequence[Record], console: Console) -> None:
    """The tables, on the terminal."""
    for setting, rows in table.items():
        own = next((record for record in records if record["setting"] == setting), None)
        about = "" if own is None else f", {own['steps']} scans, {own['true_features']} labelled features"
        columns = shown_columns(rows)
        if console.width < 100 and len(columns) > 9:
            columns = [column for column in columns if column.key not in _NARROW]
        shown = Table(title=f"{setting}{about}", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        shown.add_column("", min_width=16)
        for column in columns:
            shown.add_column(column.title, justify="right", no_wrap=True)
        for name, row in rows.items():
            shown.add_row(short(name), *(text(row[c.key], c.digits) for c in columns))
        console.print(shown)
    console.print(
        "ATE, lm.: RMSE of positions, of landmarks [m], aligned; ATE₀: not aligned.\n"
        "feat.: confirmed features; dupl.: of a landmark that has one; clut.: of none.\n"
        "s: time of the whole run.", soft_wrap=True, markup=False, highlight=False,
    )  # fmt: skip


def run_recording(a: argparse.Namespace, out: Path, common: dict[str, Any], console: Console) -> None:
    """Run all associators over all logs; tables on the terminal, files and report in `out`."""
    names = a.associators or shipped()
    logs = logs_of(a)
    for name in names:
        if name != CEILING:
            find_associator(name)  # ValueError for an associator that nobody knows
    for setting, log in logs.items():
        recording = log.open()
        console.print(f"{setting}: {recording.source} {recording.terms}", soft_wrap=True)
    folder = out / "runs"
    tasks = [RecordingRun(name, log, setting, folder) for setting, log in logs.items() for name in names]
    fixed = {"recording": a.recording, "every": a.every, "merge": a.merge, "clean": a.clean, "reference": a.reference}
    fixed |= {"settings": {setting: asdict(slam_for(log.open())) for setting, log in logs.items()}}

    def numbers(records: list[Record]) -> dict[str, Any]:
        return {"table": tables(records, names)}

    records = carry_out(tasks, out, fixed, numbers, console=console, **common)
    show(tables(records, names), records, console)
    from agents.reports.recordings import write_report  # matplotlib takes a second to import

    console.print(f"report: {write_report(out, names)}", soft_wrap=True)


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """--recording and what belongs to it."""
    group = parser.add_argument_group("recording")
    group.add_argument("--recording", metavar="LOG", help=f"EKF-SLAM over a real log: {', '.join(PUBLISHED)}, "
                       "or a file .npz, .g2o, .txt (iSAM)")  # fmt: skip
    group.add_argument("--data", type=Path, metavar="DIR", help="folder of the published files (default: the one of "
                       "that name in SLAM_GYM_DATA)")  # fmt: skip
    group.add_argument("--robots", type=int, nargs="+", metavar="N", help="of mrclam (default: all)")
    group.add_argument("--every", type=int, default=1, metavar="K", help="only each K-th scan (default: %(default)s)")
    group.add_argument("--merge", type=float, default=0.0, metavar="M", help="landmarks no farther apart are one [m]")
    group.add_argument("--clean", action="store_true", help="leave out spurious measurements, such as the barcodes "
                       "that the robots of mrclam wear themselves")  # fmt: skip
    group.add_argument("--reference", action="store_true", help="the vertices of a .g2o file are the truth")
