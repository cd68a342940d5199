"""What all evaluations of associators share: who is evaluated, tasks, a journal to resume from, estimates.

A record is one associator in one episode of one setting; every associator meets the same episodes. Where an episode
comes from is the business of its task: a drive through a scenario (`association_drives`), or a world of a level of the
suite (`suite_run`).
"""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from threadpoolctl import threadpool_limits

from agents.cli import versions
from agents.evaluation.parallel import connect, run_all
from agents.evaluation.results import Column, Journal, Record, estimate, write_csv, write_json
from slam_gym.association import ASSOCIATORS, resolve_associator
from slam_gym.metrics.statistics import Interval
from slam_gym.types import Hypothesis

Key = tuple[str, str, int]
"""associator, setting, episode"""

ORDER = (
    "nearest_neighbour", "global_nearest_neighbour", "singles", "one_point_ransac", "jcbb", "ipjc", "map_hypothesis",
    "true_association",
)  # fmt: skip
CEILING = "true_association"


class Task(Protocol):
    """A piece of work that yields one record for each of its keys."""

    @property
    def keys(self) -> tuple[Key, ...]: ...

    def without(self, done: set[Key]) -> Task | None:
        """What is left of it, or None."""

    def run(self) -> list[Record]: ...


def shipped() -> list[str]:
    """The associators that ship, in the order of tables: from the simplest to the truth."""
    return sorted(ASSOCIATORS, key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER) - 2)


def short(name: str) -> str:
    """What to call it in a table: the function of `module:function`, the name of a file."""
    return (Path(name).name if ":" not in name else name.rpartition(":")[2]).replace("_", " ")


@functools.lru_cache
def find_associator(name: str) -> Callable[..., Hypothesis]:
    """An associator by name, `module:function`, or the file of a learned one. ValueError lists the known names."""
    if Path(name).suffix in (".pt", ".zip"):
        from agents.learning.association_models import load  # torch is imported for learned associators only

        return load(Path(name))
    return resolve_associator(name)


def run_task(task: Task) -> list[Record]:
    """Run a task in whatever process this is, on one thread."""
    with threadpool_limits(1):
        return task.run()


def carry_out(
    tasks: Sequence[Task], out: Path, fixed: dict[str, Any], tables: Callable[[list[Record]], dict[str, Any]], *,
    jobs: int, backend: str = "loky", command: str = "", resume: bool = False, console: Console | None = None,
) -> list[Record]:  # fmt: skip
    """Run what the journal in `out` does not have yet; return the records of all tasks, in their order.

    `fixed` is what may not change when the evaluation is resumed; `tables` turns records into results.json. An
    interruption writes what there is and is passed on. Raises ValueError where `out` holds another evaluation.
    """
    started = datetime.now().isoformat("T", "seconds")
    commands = [*_history(out, fixed, resume), {"command": command, "started": started}]
    connect(backend, jobs)
    out.mkdir(parents=True, exist_ok=True)
    journal = Journal(out / "records.jsonl")
    found = {key_of(record): record for record in journal.read()}
    wanted = [key for task in tasks for key in task.keys]
    left = [rest for task in tasks if (rest := task.without(set(found))) is not None]
    start = time.perf_counter()
    records: list[Record] = []
    write_json(out / "results.json", {"commands": commands, "complete": False, "fixed": fixed, "versions": versions()})
    try:
        _run(left, journal, jobs, backend, console or Console())
    finally:
        commands[-1]["seconds"] = round(time.perf_counter() - start, 1)
        found = {key_of(record): record for record in journal.read()}
        records = [found[key] for key in wanted if key in found]
        about = {"commands": commands, "complete": len(records) == len(wanted), "fixed": fixed}
        write_json(out / "results.json", about | (plain(tables(records)) if records else {}) | {"versions": versions()})
        write_csv(out / "records.csv", records)
    return records


def plain(value: Any) -> Any:
    """Tables without classes, for JSON."""
    if isinstance(value, Interval):
        return asdict(value)
    return {key: plain(item) for key, item in value.items()} if isinstance(value, dict) else value


def key_of(record: Record) -> Key:
    return record["associator"], record["setting"], record["episode"]


def _run(tasks: Sequence[Task], journal: Journal, jobs: int, backend: str, console: Console) -> None:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("tasks", total=len(tasks))
        for records in run_all(tasks, jobs, backend, run_task):
            for record in records:
                journal.append(record)
            progress.advance(bar)


def _history(out: Path, fixed: dict[str, Any], resume: bool) -> list[dict[str, Any]]:
    """Earlier commands of a resumed evaluation."""
    if not (out / "results.json").exists():
        if resume:
            raise ValueError(f"{out} holds no evaluation to resume")
        return []
    if not resume:
        raise ValueError(f"{out} holds an evaluation already: give --resume to go on with it, or another --out")
    before = json.loads((out / "results.json").read_text(encoding="utf-8"))
    for name, value in fixed.items():
        if before.get("fixed", {}).get(name) != value:
            raise ValueError(f"{out} was evaluated with {name} {before.get('fixed', {}).get(name)!r}, not {value!r}")
    return list(before["commands"])


def values(records: Sequence[Record], associator: str, setting: str | None, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Values (e,) of an associator's records in one setting (None: in all), and the setting (e,) of each, by number."""
    own = [r for r in records if r["associator"] == associator and setting in (None, r["setting"])]
    names = sorted({record["setting"] for record in own})
    return np.array([r[key] for r in own], dtype=float), np.array([names.index(r["setting"]) for r in own], dtype=int)


def row(
    records: Sequence[Record], associator: str, setting: str | None, columns: Sequence[Column]
) -> dict[str, Interval]:
    """Column key → interquartile mean over episodes, with its interval; resampled within each setting."""
    return {column.key: estimate(*values(records, associator, setting, column.key)) for column in columns}


def paired(records: Sequence[Record], first: str, second: str, key: str, setting: str | None = None) -> Interval:
    """Difference first − second over the episodes that both have, with its interval."""
    of: dict[str, dict[tuple[str, int], float]] = {first: {}, second: {}}
    for record in records:
        if record["associator"] in of and setting in (None, record["setting"]):
            of[record["associator"]][record["setting"], record["episode"]] = record[key]
    common = sorted(of[first].keys() & of[second].keys())
    settings = sorted({setting for setting, _ in common})
    differences = np.array([of[first][k] - of[second][k] for k in common], dtype=float)
    return estimate(differences, np.array([settings.index(setting) for setting, _ in common], dtype=int))
