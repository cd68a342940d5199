"""The one way in which everything is evaluated: tasks, a journal to resume from, processes, files in a folder.

What is evaluated (drivers, associators in the loop, the suite, recordings) differs in its tasks and in the numbers that
are made of their records. Whatever is shown afterwards, on the terminal or in the report, is made from the folder.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from filelock import FileLock, Timeout
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from agents.evaluation.parallel import connect, run_all
from agents.evaluation.records import Journal, Key, Record, plain, setting_of, versions, write_csv, write_json


class Task(Protocol):
    """A piece of work that yields one record for each of its keys."""

    @property
    def keys(self) -> tuple[Key, ...]: ...

    def run(self, wanted: Sequence[Key]) -> list[Record]:
        """The records of some of its keys, in whatever process this is."""


class Kind(NamedTuple):
    """A kind of evaluation, and what its files are like."""

    name: str  # of the module in agents.reports that shows it
    subject: str  # the field of a record that says who was evaluated
    stem: str  # name of the files of records


DRIVERS = Kind("drivers", "agent", "episodes")
ASSOCIATORS = Kind("associators", "associator", "records")
SUITE = Kind("suite", "associator", "records")
RECORDINGS = Kind("recordings", "associator", "records")
LEADERBOARD = Kind("leaderboard", "entry", "records")
KINDS = {kind.name: kind for kind in (DRIVERS, ASSOCIATORS, SUITE, RECORDINGS, LEADERBOARD)}


@dataclass(frozen=True)
class Evaluation:
    """What is to be done, and what is made of it."""

    kind: Kind
    tasks: Sequence[Task]
    conditions: dict[str, Any]  # what may not change when the evaluation is resumed
    numbers: Callable[[list[Record]], dict[str, Any]]  # for results.json
    about: dict[str, Any] = field(default_factory=dict)  # for results.json as well, and may change


@dataclass(frozen=True)
class Execution:
    """How it is done."""

    jobs: int = 1
    backend: str = "loky"
    command: str = ""  # as it was typed
    resume: bool = False
    console: Console = field(default_factory=Console)


class Results(NamedTuple):
    """What the folder of an evaluation holds."""

    kind: Kind
    content: dict[str, Any]  # of results.json
    records: list[Record]  # those that were asked for last

    @property
    def names(self) -> list[str]:
        """Who was evaluated, of those with records, in the order in which they were asked for."""
        found = {record[self.kind.subject] for record in self.records}
        return [name for name in self.content["asked"]["names"] if name in found]


def carry_out(evaluation: Evaluation, out: Path, execution: Execution) -> Results:
    """Run what the journal in `out` does not have yet; write CSV and JSON of all that was asked for, and return it.

    An interruption writes what there is and is passed on. Raises ValueError where `out` holds another evaluation, or
    another process is writing to it.
    """
    _history(out, evaluation, execution.resume)  # refuses what is another's before a folder is made
    out.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(out / ".lock", blocking=False):
            return _carry_out(evaluation, out, execution)
    except Timeout:
        raise ValueError(f"another evaluation is being written to {out}: wait for it, or give another --out") from None


def _carry_out(evaluation: Evaluation, out: Path, execution: Execution) -> Results:
    started = {"command": execution.command, "started": datetime.now().isoformat("T", "seconds")}
    commands: list[dict[str, Any]] = [*_history(out, evaluation, execution.resume), started]
    connect(execution.backend, execution.jobs)
    setting = setting_of(evaluation.kind.name, evaluation.conditions)
    journal, subject = Journal(out / f"{evaluation.kind.stem}.jsonl", setting), evaluation.kind.subject
    done = {Key.of_record(record, subject) for record in journal.read()}
    _write(out, evaluation, commands, [])
    start = time.perf_counter()
    try:
        for records in _progress(list(_left(evaluation.tasks, done)), execution):
            for record in records:
                journal.append(record)
    finally:
        commands[-1]["seconds"] = round(time.perf_counter() - start, 1)
        _write(out, evaluation, commands, journal.read())
    return read_results(out)


def read_results(folder: Path) -> Results:
    """What the folder of an evaluation holds. ValueError where there is none, or nothing finished yet."""
    path = folder / "results.json"
    content = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if content.get("kind") not in KINDS:
        raise ValueError(f"{folder} holds no results.json of an evaluation")
    kind = KINDS[content["kind"]]
    setting = setting_of(kind.name, content["conditions"])
    records = _asked_for(Journal(folder / f"{kind.stem}.jsonl", setting).read(), kind.subject, content["asked"])
    if not records:
        raise ValueError(f"{folder} holds no finished episode yet")
    return Results(kind, content, records)


def _left(tasks: Sequence[Task], done: set[Key]) -> Iterator[Callable[[], list[Record]]]:
    """What is left of each task."""
    for task in tasks:
        if wanted := [key for key in task.keys if key not in done]:
            yield partial(task.run, wanted)


def _progress(calls: Sequence[Callable[[], list[Record]]], execution: Execution) -> Iterator[list[Record]]:
    """Run the calls under a progress bar."""
    clocks = (TimeElapsedColumn(), TimeRemainingColumn())
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), *clocks)
    with Progress(*columns, console=execution.console) as progress:
        bar = progress.add_task("tasks", total=len(calls))
        for records in run_all(calls, execution.jobs, execution.backend):
            yield records
            progress.advance(bar)


def _write(out: Path, evaluation: Evaluation, commands: list[dict[str, Any]], journal: Sequence[Record]) -> None:
    """CSV and JSON of the records that the evaluation asks for."""
    keys = [key for task in evaluation.tasks for key in task.keys]
    asked: dict[str, Any] = {
        f"{name}s": list(dict.fromkeys(getattr(key, name) for key in keys)) for name in ("name", "setting", "model")
    }
    episodes = [key.episode for key in keys] or [0]
    asked |= {"first": min(episodes), "episodes": max(episodes) + 1 - min(episodes)}
    records = _asked_for(journal, evaluation.kind.subject, asked)
    head = {"kind": evaluation.kind.name, "commands": commands, "complete": len(records) == len(keys)}
    about = {"conditions": evaluation.conditions, "asked": asked, **evaluation.about}
    numbers = evaluation.numbers(records) if records else {}
    write_json(out / "results.json", head | about | numbers | {"versions": versions()})
    if records:
        write_csv(out / f"{evaluation.kind.stem}.csv", records)


def _asked_for(records: Sequence[Record], subject: str, asked: dict[str, Any]) -> list[Record]:
    """Those that were asked for, one of each key, in an order that does not depend on who finished first."""
    found = {Key.of_record(record, subject): record for record in records}
    names, settings, models = (asked[name] for name in ("names", "settings", "models"))
    episodes = range(first := asked.get("first", 0), first + asked["episodes"])
    own = [
        key
        for key in found
        if key.name in names and key.setting in settings and key.model in models and key.episode in episodes
    ]
    own.sort(key=lambda k: (names.index(k.name), settings.index(k.setting), models.index(k.model), k.episode))
    return [found[key] for key in own]


def _history(out: Path, evaluation: Evaluation, resume: bool) -> list[dict[str, Any]]:
    """Earlier commands of a resumed evaluation."""
    path = out / "results.json"
    if not path.exists():
        if resume:
            raise ValueError(f"{out} holds no evaluation to resume")
        return []
    if not resume:
        raise ValueError(f"{out} holds an evaluation already: give --resume to go on with it, or another --out")
    before = json.loads(path.read_text(encoding="utf-8"))
    if before.get("kind") != evaluation.kind.name:
        raise ValueError(f"{out} holds an evaluation of {before.get('kind')}, not of {evaluation.kind.name}")
    for name, value in evaluation.conditions.items():
        if (was := before["conditions"].get(name)) != plain(value):
            raise ValueError(f"{out} was evaluated with {name} {was!r}, not {value!r}")
    return list(before["commands"])
