"""Evaluate agents on the same test worlds: `python -m agents.evaluate` drives the classical baselines on `office`.

Writes into OUT: episodes.jsonl (--resume goes on from it), episodes.csv, results.json, report.html and films/.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import joblib
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from agents.cli import CHECKOUT, add_world_options, command_line, run_main, setting_of, versions
from agents.drivers.base import AGENTS, BASELINES, is_learned
from agents.evaluation.parallel import BACKENDS, Driver, Task, connect, run_all
from agents.evaluation.results import (
    TABLE,
    Column,
    Journal,
    Record,
    cell,
    film_path,
    in_order,
    kidnappings,
    table,
    write_csv,
    write_json,
)
from agents.evaluation.rollout import Setting, reset_arguments
from slam_gym.metrics.statistics import Interval

EPISODES = 40


def drive(tasks: Sequence[Task], journal: Journal, jobs: int, backend: str, console: Console) -> None:
    """Run the tasks; each record is written down as it finishes."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("episodes", total=len(tasks))
        for record in run_all(tasks, jobs, backend):
            journal.append(record)
            progress.advance(bar)


def make_films(
    drivers: Iterable[Driver], setting: Setting, out: Path, jobs: int, backend: str, console: Console
) -> None:
    """One film per agent, of the first episode; those that are there already stay."""
    first = {driver.agent: driver for driver in reversed(list(drivers))}
    missing = {
        agent: film_path(out, agent) for agent in first if not film_path(out, agent).with_suffix(".png").exists()
    }
    tasks = [Task(first[agent], setting, 0, path) for agent, path in missing.items()]
    with console.status(f"filming {', '.join(missing)}"):
        list(run_all(tasks, jobs, backend))


def show(records: Sequence[Record], agents: Sequence[str], title: str, console: Console) -> None:
    """The table on the terminal, each interval under its estimate; one digit less where 80 columns have to do."""
    narrow = console.width < 100
    caption = "interquartile mean over episodes, 95 % bootstrap interval"
    shown = Table(title=title, caption=caption, box=SIMPLE_HEAD, padding=(0, 0 if narrow else 1))
    shown.add_column("agent", no_wrap=True)
    for column in TABLE:
        shown.add_column(column.title, justify="right", no_wrap=True)
    for agent, row in table(records, agents).items():
        shown.add_row(agent, *(_two_lines(row[column.key], column, narrow) for column in TABLE))
    console.print(shown)
    for line in filter(None, (kidnappings(records, agent) for agent in agents)):
        console.print(line)


def _two_lines(value: Interval, column: Column, narrow: bool) -> str:
    """The estimate, and under it the interval; without the interval of counts where the terminal is narrow."""
    estimate, _, interval = cell(value, max(column.digits - narrow, 0)).partition(" ")
    if narrow and column.digits == 0:
        return estimate
    return f"{estimate}\n{interval.strip('[]').replace(', ', '–')}"


def summary(setting: Setting, drivers: Sequence[Driver], episodes: int, records: Sequence[Record]) -> dict[str, Any]:
    """Everything in results.json but the history of commands."""
    agents = list(dict.fromkeys(driver.agent for driver in drivers))
    rows = table(records, agents) if records else {}
    return {
        "complete": len(records) == len(drivers) * episodes,
        "setting": asdict(setting),
        "agents": agents,
        "models": {driver.model: _describe(Path(driver.model)) for driver in drivers if driver.model},
        "episodes": episodes,
        "seeds": [reset_arguments(k) for k in range(episodes)],
        "table": {agent: {key: asdict(value) for key, value in row.items()} for agent, row in rows.items()},
        "versions": versions(),
    }


def _describe(model: Path) -> dict[str, Any]:
    """Hash of a model file, and what it says of its training."""
    known: dict[str, Any] = {"sha256": hashlib.sha256(model.read_bytes()).hexdigest()}
    if model.suffix == ".zip":
        return known
    from agents.learning.ppo import read_model  # torch is imported for learned agents only

    return known | {"training": read_model(model)[0].training}


def evaluate(
    drivers: Sequence[Driver], setting: Setting, episodes: int, out: Path, *, jobs: int, backend: str = "loky",
    films: bool = True, command: str = "", resume: bool = False, console: Console | None = None,
) -> list[Record]:  # fmt: skip
    """Drive every episode that the journal does not have yet; return all, in order, and write the files in `out`.

    An interruption writes what there is and is passed on. Raises ValueError where `out` holds another evaluation.
    """
    console = console or Console()
    commands = [
        *_history(out, setting, resume),
        {"command": command, "started": datetime.now().isoformat("T", "seconds")},
    ]
    wanted = [Task(driver, setting, k) for k in range(episodes) for driver in drivers]
    connect(backend, jobs)
    _warm_up(drivers, setting)
    out.mkdir(parents=True, exist_ok=True)
    journal = Journal(out / "episodes.jsonl")
    done = {_key(record) for record in journal.read()}
    _write(out, setting, drivers, episodes, [], commands)
    start = time.perf_counter()
    records: list[Record] = []
    try:
        drive([task for task in wanted if task.key not in done], journal, jobs, backend, console)
        if films:
            make_films(drivers, setting, out, jobs, backend, console)
    finally:
        commands[-1]["seconds"] = round(time.perf_counter() - start, 1)
        keys = {task.key for task in wanted}
        found = {_key(record): record for record in journal.read() if _key(record) in keys}
        records = in_order(list(found.values()), [driver.agent for driver in drivers])
        _write(out, setting, drivers, episodes, records, commands)
    return records


def _key(record: Record) -> tuple[str, str | None, int]:
    return record["agent"], record["model"], record["episode"]


def _write(
    out: Path, setting: Setting, drivers: Sequence[Driver], episodes: int, records: Sequence[Record],
    commands: list[dict[str, Any]],
) -> None:  # fmt: skip
    write_csv(out / "episodes.csv", records)
    write_json(out / "results.json", {"commands": commands} | summary(setting, drivers, episodes, records))


def _history(out: Path, setting: Setting, resume: bool) -> list[dict[str, Any]]:
    """Earlier commands of a resumed evaluation."""
    if not (out / "results.json").exists():
        if resume:
            raise ValueError(f"{out} holds no evaluation to resume")
        return []
    if not resume:
        raise ValueError(f"{out} holds an evaluation already: give --resume to go on with it, or another --out")
    before = json.loads((out / "results.json").read_text(encoding="utf-8"))
    for name, value in asdict(setting).items():
        if before["setting"].get(name) != value:
            raise ValueError(f"{out} was evaluated with {name} {before['setting'].get(name)!r}, not {value!r}")
    return list(before["commands"])


def _warm_up(drivers: Sequence[Driver], setting: Setting) -> None:
    """Report faults before any worker starts, and compile the inner loops once instead of in every worker."""
    actions = {driver.make().action for driver in drivers}
    for action in actions:
        env = setting.make(action)
        env.reset(**reset_arguments(0))
        env.step(0 if action == "goal" else env.action_space.sample())
        env.close()


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="python -m agents.evaluate", description="Evaluate agents on the same test worlds."
    )
    p.add_argument("--agents", nargs="+", metavar="NAME", help=f"of {', '.join(AGENTS)}, or module:Class "
                   f"(default: {' '.join(BASELINES)})")  # fmt: skip
    p.add_argument("--model", nargs="+", default=[], metavar="FILE", help="model of a learned agent; several files are "
                   "several training seeds of it, pooled")  # fmt: skip
    p.add_argument("--trust", action="store_true", help="allow model files that can run code when read (SB3's .zip)")
    p.add_argument("--episodes", type=int, default=EPISODES, metavar="N", help="per agent (default: %(default)s)")
    p.add_argument("--jobs", type=int, default=joblib.cpu_count(), metavar="J", help="processes (default: %(default)s)")
    p.add_argument("--backend", default="loky", choices=BACKENDS, help="of joblib (default: %(default)s)")
    p.add_argument("--out", type=Path, metavar="DIR", help="default: results/WORLD-TIME")
    p.add_argument("--resume", action="store_true", help="go on with an interrupted evaluation (default: the latest)")
    p.add_argument("--no-films", dest="films", action="store_false", help="leave the films out")
    add_world_options(p, "office")
    return p


def drivers_of(names: Sequence[str], models: Sequence[str], trust: bool) -> list[Driver]:
    """The drivers that --agents and --model ask for; a model alone adds `ppo` to the agents."""
    names = list(dict.fromkeys(names))
    if models and not any(is_learned(name) for name in names):
        names.append("ppo")
    files: list[str | None] = [str(Path(model).resolve()) for model in models]
    none: list[str | None] = [None]
    return [Driver(name, file, trust) for name in names for file in (is_learned(name) and files) or none]


def default_out(world: str, resume: bool) -> Path:
    """A new folder under results/, or the latest one of this world."""
    name = Path(world).name.split(".")[0]
    results = CHECKOUT / "results"
    if not resume:
        return results / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
    folders = sorted(results.glob(f"{name}-[0-9]*"))
    if not folders:
        raise ValueError(f"there is no evaluation of {name} to resume in {results}: give its folder with --out")
    return folders[-1]


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    for name in ("episodes", "jobs"):
        if getattr(a, name) < 1:
            raise ValueError(f"--{name} must be at least 1, not {getattr(a, name)}")
    setting = setting_of(a, split="test")
    drivers = drivers_of(a.agents or BASELINES, a.model, a.trust)
    out = a.out or default_out(setting.world, a.resume)
    console = Console()
    try:
        records = evaluate(
            drivers, setting, a.episodes, out, jobs=a.jobs, backend=a.backend, films=a.films,
            command=command_line("agents.evaluate", argv), resume=a.resume, console=console,
        )  # fmt: skip
    except KeyboardInterrupt:
        console.print(f"interrupted; go on with the same command and --resume --out {out}", soft_wrap=True)
        raise
    from agents.reports.evaluation import write_report  # matplotlib takes a second to import

    show(
        records,
        list(dict.fromkeys(driver.agent for driver in drivers)),
        f"{setting.world}, {a.episodes} episodes",
        console,
    )
    console.print(f"report: {write_report(out)}", soft_wrap=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
