"""Evaluate associators: `python -m agents.evaluate_association` puts each into the loop on the same test worlds;
`--suite` asks all of them about the same scans, one number per capability; `--recording` runs them over a real log.

Writes into OUT: records.jsonl (--resume goes on from it), records.csv, results.json and report.html.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import joblib
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from agents.cli import CHECKOUT, command_line, run_main
from agents.drivers.base import AGENTS
from agents.evaluation.associators import ORDER, carry_out, row, shipped, short
from agents.evaluation.drives import Course, columns_for, drives
from agents.evaluation.drives import tables as drive_tables
from agents.evaluation.parallel import BACKENDS
from agents.evaluation.recordings import add_recording_options, run_recording
from agents.evaluation.results import Record, cell
from agents.suite.run import OUTCOMES, by_world, capabilities, names_of, number, over_all, ranked, worlds
from agents.suite.run import tables as suite_tables
from slam_gym.association import RELOCATORS
from slam_gym.metrics.statistics import Interval
from slam_gym.scenarios import SCENARIOS, SPLITS
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION

SETTINGS = ("office-small", "hall", "crowd")
EPISODES = 8
WORLDS, PROBLEMS = 24, 12
LEFT_OUT, BARE = (
    ("F1", "wrong reloc.", "ticks astray"),
    ("ANEES", "recovered"),
)  # columns, intervals: where 80 characters must do
QUICK_WORLDS, QUICK_PROBLEMS = 4, 8


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="python -m agents.evaluate_association", description="Evaluate associators on the same test worlds."
    )
    p.add_argument("--associators", nargs="+", metavar="NAME", help=f"of {', '.join(ORDER)}, module:function, "
                   "or the file of a learned one (default: all that ship)")  # fmt: skip
    p.add_argument("--jobs", type=int, default=joblib.cpu_count(), metavar="J", help="processes (default: %(default)s)")
    p.add_argument("--backend", default="loky", choices=BACKENDS, help="of joblib (default: %(default)s)")
    p.add_argument("--out", type=Path, metavar="DIR", help="default: results/association-TIME or results/suite-TIME")
    p.add_argument("--resume", action="store_true", help="go on with the interrupted evaluation in --out")
    p.add_argument("--split", default="test", choices=SPLITS, help="worlds; tune on train (default: %(default)s)")
    loop = p.add_argument_group("in the loop")
    loop.add_argument("--scenarios", nargs="+", default=list(SETTINGS), metavar="NAME",
                      help=f"of {', '.join(SCENARIOS)}, or "
                      "levels of the suite such as clutter/2 (default: %(default)s)")  # fmt: skip
    loop.add_argument("--episodes", type=int, default=EPISODES, metavar="N", help="a scenario (default: %(default)s)")
    loop.add_argument("--driver", default="nearest_frontier", metavar="AGENT", help=f"of {', '.join(AGENTS)} but "
                      "learned ones, or module:Class (default: %(default)s)")  # fmt: skip
    loop.add_argument("--relocation", metavar="SEARCH", help=f"how a lost robot is found: {', '.join(RELOCATORS)}, or "
                      "module:function (default: not at all)")  # fmt: skip
    suite = p.add_argument_group("suite")
    suite.add_argument("--suite", action="store_true", help="one number per capability instead of drives")
    suite.add_argument("--quick", action="store_true", help="every second level, few worlds")
    suite.add_argument("--experiments", nargs="+", default=list(EXPERIMENTS), metavar="NAME",
                       help="default: %(default)s")  # fmt: skip
    suite.add_argument("--relocators", nargs="+", metavar="NAME", help="for kidnapped (default: all that ship)")
    suite.add_argument("--worlds", type=int, metavar="W", help=f"a level (default: {WORLDS}; quick: {QUICK_WORLDS})")
    suite.add_argument("--problems", type=int, metavar="P", help=f"a world (default: {PROBLEMS}; quick: "
                       f"{QUICK_PROBLEMS})")  # fmt: skip
    add_recording_options(p)
    return p


def run_drives(a: argparse.Namespace, out: Path, common: dict[str, Any], console: Console) -> None:
    """Drive, print the tables, write the report."""
    names, settings = a.associators or shipped(), list(dict.fromkeys(a.scenarios))
    courses = [Course(setting, a.driver, a.relocation, a.split) for setting in settings]
    tasks = drives(names, courses, a.episodes)
    fixed = {"driver": a.driver, "relocation": a.relocation, "split": a.split}

    def tables(records: list[Record]) -> dict[str, Any]:
        return {"episodes": a.episodes, "table": drive_tables(records, names, settings)}

    records = carry_out(tasks, out, fixed, tables, console=console, **common)
    for setting in settings:
        own = [record for record in records if record["setting"] == setting]
        columns = columns_for(own)
        rows = {name: [row(own, name, None, columns)[c.key] for c in columns] for name in names}
        titles = [(column.title, column.digits) for column in columns]
        show(rows, titles, f"{setting}, {a.episodes} episodes, driven by {a.driver}", console)
    from agents.reports.associators import write_report  # matplotlib takes a second to import

    console.print(f"report: {write_report(out, names, settings)}", soft_wrap=True)


def run_suite(a: argparse.Namespace, out: Path, common: dict[str, Any], console: Console) -> None:
    """Ask, print the numbers, write the report."""
    names, searches = a.associators or shipped(), a.relocators or list(RELOCATORS)
    count, each = (QUICK_WORLDS, QUICK_PROBLEMS) if a.quick else (WORLDS, PROBLEMS)
    count, each = a.worlds or count, a.problems or each
    tasks = worlds(names, searches, list(dict.fromkeys(a.experiments)), count, each, a.split, a.quick)
    fixed = {"suite": True, "quick": a.quick, "worlds": count, "problems": each, "split": a.split}
    records = carry_out(tasks, out, fixed, suite_tables, console=console, **common)
    about = f"{count} worlds a level, up to {each} scans in each"
    if order := ranked(records):
        shown = capabilities(records)
        rows = {
            name: [*(number(by_world(records, name, e)) for e in shown), number(over_all(records, name, shown))]
            for name in order
        }
        show(rows, [(e, 3) for e in [*shown, "all"]], f"association suite, {about}", console)
    if found := names_of(records, relocators=True):
        relocation = suite_tables(records)["relocation"]
        rows = {
            name: [relocation[name][RELOCATION], *(Interval(*[float(relocation[name][o])] * 3) for o in OUTCOMES)]
            for name in found
        }
        columns = [("score", 3), *((outcome, 0) for outcome in OUTCOMES)]
        show(rows, columns, f"kidnapped: searches without a prior, {about}", console)
    from agents.reports.suite import write_report

    console.print(f"report: {write_report(out)}", soft_wrap=True)


def show(rows: dict[str, list[Interval]], columns: Sequence[tuple[str, int]], title: str, console: Console) -> None:
    """A table on the terminal, each interval under its estimate; less of it where the terminal is narrow."""
    caption = "interquartile mean, 95 % bootstrap interval"
    narrow = console.width < 120
    shown = Table(title=title, caption=caption, box=SIMPLE_HEAD, padding=(0, 0 if narrow else 1))
    shown.add_column("", min_width=12 if narrow else None)
    kept = [k for k, (name, _) in enumerate(columns) if not (narrow and name in LEFT_OUT)]
    for k in kept:
        shown.add_column(columns[k][0], justify="right", no_wrap=True)
    for name, values in rows.items():
        cells = [_two_lines(values[k], *columns[k], narrow) for k in kept]
        shown.add_row(short(name), *cells)
    console.print(shown)


def _two_lines(value: Interval, name: str, digits: int, narrow: bool) -> str:
    """The estimate, and under it the interval; shorter where the terminal is narrow."""
    if narrow and (digits < 2 or name in BARE):
        return cell(value, digits).partition(" ")[0]
    estimate, _, interval = cell(value, digits - narrow).partition(" ")
    interval = interval.strip("[]").replace(", ", "–")
    if set(interval.split("–")) == {estimate}:
        return estimate
    return f"{estimate}\n{interval.replace('0.', '.') if narrow else interval}"


def default_out(kind: str, resume: bool) -> Path:
    """A new folder under results/, or the latest one of this kind."""
    results = CHECKOUT / "results"
    if not resume:
        return results / f"{kind}-{datetime.now():%Y%m%d-%H%M%S}"
    folders = sorted(results.glob(f"{kind}-[0-9]*"))
    if not folders:
        raise ValueError(f"there is nothing to resume in {results}: give its folder with --out")
    return folders[-1]


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    for name in ("episodes", "jobs", "worlds", "problems", "every"):
        if (value := getattr(a, name)) is not None and value < 1:
            raise ValueError(f"--{name} must be at least 1, not {value}")
    if a.suite and a.recording:
        raise ValueError("--suite and --recording are two evaluations: give one of them")
    kind, evaluate = "association", run_drives
    if a.suite or a.recording:
        kind, evaluate = ("suite", run_suite) if a.suite else ("recording", run_recording)
    out = a.out or default_out(kind, a.resume)
    command = command_line("agents.evaluate_association", argv)
    common = {"jobs": a.jobs, "backend": a.backend, "command": command, "resume": a.resume}
    console = Console()
    try:
        evaluate(a, out, common, console)
    except KeyboardInterrupt:
        console.print(f"interrupted; go on with the same command and --resume --out {out}", soft_wrap=True)
        raise
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
