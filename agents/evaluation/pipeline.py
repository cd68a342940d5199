"""The one way in which everything is evaluated: tasks, shared out over processes, and the folder of their results.

The folder holds `results.csv`, one row per episode (`pandas.read_csv`), and `results.json`: the commands, conditions,
seeds and versions behind it. Tables and reports are made from these two files.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import joblib
import pandas as pd
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from typer import Option

import slam_gym
from agents.evaluation.parallel import connect, run_all
from agents.evaluation.records import (
    Key,
    Record,
    command_line,
    plain,
    stem,
    undamaged,
    versions,
    write_json,
    written_whole,
)
from slam_gym._files import content_of, json_of

KINDS = ("drivers", "associators", "suite", "recordings", "leaderboard")
METADATA = "results.json"
_TYPES = {
    "kind": str, "commands": list, "complete": bool, "conditions": dict, "versions": dict,
}  # fmt: skip


class Task(NamedTuple):
    """A piece of work that yields one record for each of its keys."""

    keys: tuple[Key, ...]
    run: Callable[[Sequence[Key]], list[Record]]  # the records of some of its keys, in whatever process this is


@dataclass(frozen=True)
class Evaluation:
    """What is to be done."""

    kind: str  # of KINDS
    tasks: Sequence[Task]
    conditions: dict[str, Any]  # what may not change when the evaluation is resumed
    about: dict[str, Any] = field(default_factory=dict)  # for results.json as well, and may change


@dataclass(frozen=True)
class Execution:
    """How it is done, and where its files go."""

    jobs: Annotated[int, Option(min=1, metavar="J", help="Processes.")] = joblib.cpu_count()
    backend: Annotated[Literal["loky", "ray", "dask"], Option(help="Of joblib.")] = "loky"
    out: Annotated[Path | None, Option(metavar="DIR", help="By default a new folder in results/.")] = None
    resume: Annotated[bool, Option("--resume", help="Go on where an evaluation was interrupted.")] = False

    def folder(self, name: str) -> Path:
        """Where the files go. ValueError where there is nothing to resume."""
        return self.out or results_folder(name, self.resume)


def results_folder(name: str, resume: bool) -> Path:
    """A new folder under results/ of the current directory, or the latest one of that name."""
    results, name = Path("results"), stem(name)
    if not resume:
        return results / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
    folders = sorted(results.glob(f"{name}-[0-9]*"))
    if not folders:
        raise ValueError(f"there is no evaluation of {name} to resume in {results.resolve()}: give its --out")
    return folders[-1]


class Results(NamedTuple):
    """What the folder of an evaluation holds."""

    metadata: dict[str, Any]  # results.json: kind, commands, conditions, whether it is complete, versions …
    frame: pd.DataFrame  # results.csv: what was asked for last comes first, in the order in which it was asked for

    @property
    def conditions(self) -> dict[str, Any]:
        """What all episodes share."""
        return dict(self.metadata["conditions"])

    @property
    def names(self) -> list[str]:
        """Who was evaluated."""
        return list(self.frame["name"].unique())


def carry_out(evaluation: Evaluation, out: Path, execution: Execution) -> Results:
    """Run the tasks whose records `out` does not hold yet, and return the results.

    What is finished is written at once, so that an interrupted evaluation can be resumed. Raises ValueError where `out`
    holds anything but an evaluation to resume with the same conditions.
    """
    commands, records = _to_go_on_from(out, evaluation, execution.resume)
    order = {key: position for position, key in enumerate(key for task in evaluation.tasks for key in task.keys)}
    done = {_key(record) for record in records}
    left = [(task, [key for key in task.keys if key not in done]) for task in evaluation.tasks]
    calls = [partial(task.run, keys) for task, keys in left if keys]
    commands.append({"command": command_line(), "started": datetime.now().isoformat("T", "seconds")})
    connect(execution.backend, execution.jobs)
    out.mkdir(parents=True, exist_ok=True)
    _write_metadata(out, evaluation, commands, complete=not calls)
    start = time.perf_counter()
    try:
        for finished in _progress(calls, execution):
            records = sorted([*records, *finished], key=lambda record: order.get(_key(record), len(order)))
            _write_records(out, records)
    finally:
        commands[-1]["seconds"] = round(time.perf_counter() - start, 1)
        _write_metadata(out, evaluation, commands, complete=order.keys() <= {_key(record) for record in records})
    return read_results(out)


def read_results(folder: Path) -> Results:
    """What the folder of an evaluation holds. ValueError where there is none, or nothing finished yet."""
    metadata = _read_metadata(folder)
    if metadata is None:
        raise ValueError(f"{folder} holds no results.json of an evaluation")
    frame = _read_records(folder)
    if frame.empty:
        raise ValueError(f"{folder} holds no finished episode yet")
    return Results(metadata, frame)


def _read_metadata(folder: Path) -> dict[str, Any] | None:
    """What results.json says, or None where there is none. ValueError names one that is damaged."""
    if not (folder / METADATA).exists():
        return None
    with undamaged(folder / METADATA):
        metadata: dict[str, Any] = json_of(content_of(folder / METADATA))
        wrong = [name for name, kind in _TYPES.items() if not isinstance(metadata[name], kind)]
        if wrong or metadata["kind"] not in KINDS:
            raise ValueError(f"{(wrong or ['kind'])[0]} is not what an evaluation writes")
    return metadata


def _write_metadata(out: Path, evaluation: Evaluation, commands: Sequence[dict[str, Any]], *, complete: bool) -> None:
    head = {"kind": evaluation.kind, "commands": commands, "complete": complete}
    write_json(out / METADATA, head | {"conditions": evaluation.conditions, **evaluation.about, "versions": versions()})


def _read_records(folder: Path) -> pd.DataFrame:
    """What results.csv holds: nothing where there is none. ValueError names one that is damaged."""
    path = folder / "results.csv"
    if not path.exists():
        return pd.DataFrame(columns=Key._fields)
    with undamaged(path):
        frame = pd.read_csv(path, dtype={"name": str, "setting": str, "model": str, "episode": int})
        return frame.set_index(list(Key._fields)).reset_index().fillna({"model": ""})


def _write_records(out: Path, records: Sequence[Record]) -> None:
    cells = [{key: json.dumps(v) if isinstance(v, list | dict) else v for key, v in r.items()} for r in records]
    with written_whole(out / "results.csv") as partial:
        pd.DataFrame(cells).set_index(list(Key._fields)).to_csv(partial)


def _key(record: Record) -> Key:
    return Key(*(record[field] for field in Key._fields))


def _progress(calls: Sequence[Callable[[], list[Record]]], execution: Execution) -> Iterator[list[Record]]:
    """Run the calls under a progress bar."""
    clocks = (TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(TextColumn("tasks"), BarColumn(), MofNCompleteColumn(), *clocks) as progress:
        bar = progress.add_task("", total=len(calls))
        for records in run_all(calls, execution.jobs, execution.backend):
            yield records
            progress.advance(bar)


def _to_go_on_from(
    out: Path, evaluation: Evaluation, resume: bool
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Commands and records of the evaluation that is resumed; none of a new one. ValueError where the folder belongs to
    something else."""
    before = _read_metadata(out)
    if before is None:
        if resume:
            raise ValueError(f"{out} holds no evaluation to resume")
        if out.is_dir() and any(out.iterdir()):
            raise ValueError(f"{out} is not empty: give another --out")
        return [], []
    was = before["conditions"] | {"evaluation": before["kind"], "slam_gym": before["versions"].get("slam_gym")}
    now = plain(evaluation.conditions) | {"evaluation": evaluation.kind, "slam_gym": slam_gym.__version__}
    if other := [f"{name} {was.get(name)!r}, not {now[name]!r}" for name in now if was.get(name) != now[name]]:
        raise ValueError(f"{out} holds the results of another command ({'; '.join(other)}): give another --out")
    if not resume:
        raise ValueError(f"{out} holds an evaluation already: give --resume to go on with it, or another --out")
    return before["commands"], _read_records(out).to_dict("records")
