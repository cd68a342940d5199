"""The pipeline of all evaluations: tasks, distributed over processes, and the folder of their results.

The folder contains `results.csv`, one row per episode (`pandas.read_csv`), and `results.json` with the commands,
conditions and versions behind it. Tables and reports are made from these two files.
"""

import json
import multiprocessing
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import joblib
import pandas as pd
from rich.progress import track
from threadpoolctl import threadpool_limits

import slam_gym
from agents.evaluation.records import Record, command_line, plain, undamaged, versions, write_whole
from slam_gym._files import content_of, json_of

KINDS = ("drivers", "associators", "suite", "recordings", "leaderboard")
METADATA, TABLE = "results.json", "results.csv"
_TYPES = {"kind": str, "commands": list, "complete": bool, "conditions": dict, "versions": dict}

Result = TypeVar("Result")


class Key(NamedTuple):
    """The identity of a row of an evaluation."""

    name: str  # of the agent or associator
    setting: str  # scenario, level of the suite or log
    episode: int
    model: str = ""  # file of a learned agent


_key = itemgetter(*Key._fields)  # of a row


class Task(NamedTuple):
    """A piece of work that returns one record for each of its keys. It can be pickled, to run in another process."""

    keys: Sequence[Key]
    run: Callable[[], Sequence[Record]]

    def rows(self) -> list[Record]:
        """Run the task; returns its rows of the table of results."""
        return [key._asdict() | record for key, record in zip(self.keys, self.run(), strict=True)]


@dataclass(frozen=True)
class Evaluation:
    """The tasks of an evaluation, and its description."""

    kind: str  # of KINDS
    tasks: Sequence[Task]
    conditions: dict[str, Any]  # must be the same when the evaluation is resumed
    about: dict[str, Any] = field(default_factory=dict)  # further entries of results.json, which may change


class Results(NamedTuple):
    """The contents of the folder of an evaluation."""

    metadata: dict[str, Any]  # results.json: kind, commands, conditions, whether it is complete, versions …
    frame: pd.DataFrame  # results.csv: rows of the latest command first, in the order of its tasks

    @property
    def conditions(self) -> dict[str, Any]:
        return dict(self.metadata["conditions"])

    @property
    def names(self) -> list[str]:
        return list(self.frame["name"].unique())


def carry_out(evaluation: Evaluation, out: Path, jobs: int | None = None, resume: bool = False) -> Results:
    """Run the tasks whose rows are not in `out` yet, and return the results.

    Finished tasks are written at once, so that an interrupted evaluation can be resumed. `jobs` as in `run_all`. Raises
    ValueError where `out` contains anything but an evaluation that can be resumed with the same conditions.
    """
    before = _to_resume(out, evaluation, resume)
    commands, rows = (before.metadata["commands"], before.frame.to_dict("records")) if before else ([], [])
    known = before.metadata.get("models", {}) if before else {}  # the rows of earlier commands are theirs
    commands.append({"command": command_line(), "started": datetime.now().isoformat("T", "seconds")})
    order = {key: position for position, key in enumerate(key for task in evaluation.tasks for key in task.keys)}
    done, start = set(map(_key, rows)), time.perf_counter()
    remaining = [task for task in evaluation.tasks if not done.issuperset(task.keys)]

    def write_metadata() -> None:
        head = {"kind": evaluation.kind, "commands": commands, "complete": done >= order.keys()}
        about = evaluation.about | {"models": known | evaluation.about.get("models", {})}
        more = {"conditions": evaluation.conditions, **about, "versions": versions()}
        write_whole(out / METADATA, json.dumps(plain(head | more), indent=1, ensure_ascii=False) + "\n")

    out.mkdir(parents=True, exist_ok=True)
    write_metadata()
    try:
        finished = run_all([task.rows for task in remaining], jobs)
        for new_rows in track(finished, "episodes", total=len(remaining)):
            rows += [row for row in new_rows if _key(row) not in done]
            rows.sort(key=lambda row: order.get(_key(row), len(order)))
            _write_rows(out, rows)
            done |= set(map(_key, new_rows))
    finally:
        commands[-1]["seconds"] = round(time.perf_counter() - start, 1)
        write_metadata()
    return read_results(out)


def unfinished(folder: Path) -> bool:
    """Whether a folder contains an evaluation that was not finished. Raises ValueError where it is damaged."""
    results = _read(folder)
    return results is not None and not results.metadata["complete"]


def run_all(calls: Sequence[Callable[[], Result]], jobs: int | None) -> Iterator[Result]:
    """The results of calls that can be pickled, in the order in which they finish. They run in `jobs` processes, by
    default one per core, with one thread each."""
    # A worker grows when it first imports torch. loky takes this for a leak, replaces the worker and warns.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
    parallel = joblib.Parallel(n_jobs=jobs or joblib.cpu_count(), return_as="generator_unordered", batch_size=1)
    return parallel(joblib.delayed(_on_one_thread)(call) for call in calls)


def _on_one_thread(call: Callable[[], Any]) -> Any:
    """Call with one thread for BLAS and torch, since processes use all cores. Workers leave Ctrl-C to the parent."""
    own_process = multiprocessing.parent_process() is not None
    if own_process and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    with threadpool_limits(1):
        return call()


# -- the folder ----------------------------------------------------------------------------------------------------


def read_results(folder: Path) -> Results:
    """Read the folder of an evaluation. Raises ValueError where it contains none, or no finished episode."""
    results = _read(folder)
    if results is None:
        raise ValueError(f"{folder} holds no results.json of an evaluation")
    if results.frame.empty:
        raise ValueError(f"{folder} holds no finished episode yet")
    return results


def _read(folder: Path) -> Results | None:
    """Read a complete or incomplete evaluation; None where there is none. Raises ValueError, naming a damaged file."""
    if not (folder / METADATA).exists():
        return None
    with undamaged(folder / METADATA):
        metadata: dict[str, Any] = json_of(content_of(folder / METADATA))
        wrong = [name for name, kind in _TYPES.items() if not isinstance(metadata[name], kind)]
        models = metadata.get("models", {})
        if not (isinstance(models, dict) and all(isinstance(m, dict) and "sha256" in m for m in models.values())):
            wrong.append("models")
        if wrong or metadata["kind"] not in KINDS:
            raise ValueError(f"{(wrong or ['kind'])[0]} is not what an evaluation writes")
    if not (folder / TABLE).exists():
        return Results(metadata, pd.DataFrame(columns=Key._fields))
    with undamaged(folder / TABLE):
        frame, text = pd.read_csv(folder / TABLE, dtype={"episode": int}), ["name", "setting", "model"]
        as_written = pd.read_csv(folder / TABLE, usecols=text, dtype=str, keep_default_na=False)  # also where it is NA
        frame[text] = as_written[text]
        if frame.duplicated([*Key._fields]).any():
            raise ValueError("an episode is there twice")
        return Results(metadata, frame.set_index([*Key._fields]).reset_index())


def _write_rows(out: Path, rows: Sequence[Record]) -> None:
    cells = [{key: json.dumps(v) if isinstance(v, list | dict) else v for key, v in row.items()} for row in rows]
    write_whole(out / TABLE, pd.DataFrame(cells).set_index([*Key._fields]).to_csv())


def _to_resume(out: Path, evaluation: Evaluation, resume: bool) -> Results | None:
    """The evaluation to resume, if any. Raises ValueError where the folder contains anything else."""
    before = _read(out)
    if before is None:
        if resume:
            raise ValueError(f"{out} holds no evaluation to resume")
        if out.is_dir() and any(out.iterdir()):
            raise ValueError(f"{out} is not empty: give another --output")
        return None
    if before.frame.empty and {path.name for path in out.iterdir()} == {METADATA}:
        return None  # the former command failed before its first episode ended
    versions = before.metadata["versions"]
    was = before.conditions | {"evaluation": before.metadata["kind"], "slam_gym": versions.get("slam_gym")}
    now = plain(evaluation.conditions) | {"evaluation": evaluation.kind, "slam_gym": slam_gym.__version__}
    if other := [f"{name} {was.get(name)!r}, not {now[name]!r}" for name in now if was.get(name) != now[name]]:
        raise ValueError(f"{out} holds the results of another command ({'; '.join(other)}): give another --output")
    models = before.metadata.get("models", {})
    for path, known in evaluation.about.get("models", {}).items():
        if models.get(path, known)["sha256"] != known["sha256"]:
            raise ValueError(f"{path} is not the file of which {out} holds results: give another --output")
    if not resume:
        raise ValueError(f"{out} holds an evaluation already: give --resume to go on with it, or another --output")
    return before
