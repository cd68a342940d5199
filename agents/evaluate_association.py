"""Evaluate associators: `python -m agents.evaluate_association` puts each into the loop on the same test worlds;
`--suite` asks all of them about the same scans, one number per capability; `--recording` runs them over a real log.

Writes into OUT: records.jsonl (--resume goes on from it), records.csv, results.json and report.html.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from agents.cli import (
    ON_A_FLOOR,
    add_episode_options,
    add_execution_options,
    add_floor_options,
    add_override_option,
    add_rerun_option,
    command_line,
    episodes_of,
    execution,
    program,
    require_positive,
    require_rerun,
    results_folder,
    run_main,
    say_where,
    search_or_none,
)
from agents.drivers.base import AGENTS, make_agent
from agents.evaluation import associators, recordings
from agents.evaluation.associators import SIMPLEST_FIRST, associator_evaluation, metered, shipped
from agents.evaluation.episodes import ExploreArguments
from agents.evaluation.pipeline import Evaluation, Results, carry_out
from agents.evaluation.recordings import Log, logs_of, recording_evaluation
from agents.evaluation.tables import Table, print_table
from agents.suite import numbers as suite
from agents.suite.worlds import SuiteSize, suite_evaluation
from slam_gym.association import RELOCATORS
from slam_gym.recordings.catalogue import PUBLISHED
from slam_gym.scenarios import SCENARIOS, SPLITS
from slam_gym.scenarios.suite import EXPERIMENTS
from slam_gym.slam.relocate import SEARCH

LOOPS = ("office-small", "hall", "crowd")
EPISODES = 30
SIZE, QUICK = SuiteSize(), SuiteSize(worlds=4, problems=8, quick=True)


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog=program("agents.evaluate_association"), description="Evaluate associators on the same test worlds."
    )
    p.add_argument("--associators", nargs="+", metavar="NAME", help=f"of {', '.join(SIMPLEST_FIRST)}, "
                   "true_association, module:function, or the file of a learned one (default: all that "
                   "ship)")  # fmt: skip
    add_execution_options(p, "results/association-TIME, suite-TIME or recording-TIME")
    p.add_argument("--split", default="test", choices=SPLITS, help="worlds; tune on train (default: %(default)s)")
    _add_loop_options(p)
    _add_suite_options(p)
    _add_recording_options(p)
    return p


def _add_loop_options(p: argparse.ArgumentParser) -> None:
    loop = p.add_argument_group("in the loop")
    loop.add_argument("--scenarios", nargs="+", metavar="NAME", help=f"of {', '.join(SCENARIOS)}, or levels of the "
                      f"suite such as clutter/2, or module:name (default {' '.join(LOOPS)}; on a floor plan "
                      f"{ON_A_FLOOR})")  # fmt: skip
    add_floor_options(loop)
    add_rerun_option(loop)
    add_override_option(loop)
    add_episode_options(loop, EPISODES, "a scenario")
    loop.add_argument("--driver", default="information_gain", metavar="AGENT", help=f"of {', '.join(AGENTS)} but "
                      "learned ones, or module:Class (default: %(default)s)")  # fmt: skip
    loop.add_argument("--relocation", nargs="+", type=search_or_none, metavar="SEARCH",
                      help=f"how a lost robot is found: {', '.join(RELOCATORS)}, module:function, or none; several are "
                      f"compared (default: none {SEARCH}; over a recording: {SEARCH})")  # fmt: skip


def _add_suite_options(p: argparse.ArgumentParser) -> None:
    suite = p.add_argument_group("suite")
    suite.add_argument("--suite", action="store_true", help="one number per capability instead of drives")
    suite.add_argument("--quick", action="store_true", help="every second level, few worlds")
    suite.add_argument("--experiments", nargs="+", default=list(EXPERIMENTS), metavar="NAME",
                       help="default: %(default)s")  # fmt: skip
    suite.add_argument("--relocators", nargs="+", metavar="NAME", help="for kidnapped (default: all that ship)")
    suite.add_argument("--worlds", type=int, metavar="W", help=f"a level (default: {SIZE.worlds}; quick: "
                       f"{QUICK.worlds})")  # fmt: skip
    suite.add_argument("--problems", type=int, metavar="P", help=f"a world (default: {SIZE.problems}; quick: "
                       f"{QUICK.problems})")  # fmt: skip


def _add_recording_options(p: argparse.ArgumentParser) -> None:
    group = p.add_argument_group("recording")
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


class Plan(NamedTuple):
    """An evaluation that the options choose, and how its results are shown."""

    evaluation: Evaluation
    tables: Callable[[Results], list[Table]]
    log: Callable[[str], list[str]] | None = None  # writes drives for Rerun's viewer; the files


def loop_plan(a: argparse.Namespace, out: Path) -> Plan:
    """Drives through scenarios. ValueError for whatever nobody knows."""
    plan = str(Path(a.floor_plan).resolve()) if a.floor_plan else None
    scenarios = a.scenarios or ([ON_A_FLOOR] if plan else LOOPS)
    world = {"split": a.split, "floor_plan": plan, "resolution": a.resolution}
    loops = [ExploreArguments(name, tuple(a.overrides), **world) for name in dict.fromkeys(scenarios)]
    names, searches = a.associators or shipped(), list(dict.fromkeys(a.relocation or [None, SEARCH]))

    def log(target: str) -> list[str]:
        """The first scenario, with the last of the searches."""
        from agents.reports.rerun_log import Drive, log_drives

        first = replace(loops[0], relocation=searches[-1])
        return log_drives(
            target, a.first, [Drive(name, first, make_agent(a.driver), metered(name)[1]) for name in names]
        )

    return Plan(associator_evaluation(names, loops, a.driver, episodes_of(a), searches), associators.tables, log)


def suite_plan(a: argparse.Namespace, out: Path) -> Plan:
    """The suite. ValueError for whatever nobody knows."""
    default = QUICK if a.quick else SIZE
    size = SuiteSize(a.worlds or default.worlds, a.problems or default.problems, a.quick, a.split)
    names, searches = a.associators or shipped(), a.relocators or list(RELOCATORS)
    return Plan(suite_evaluation(names, searches, list(dict.fromkeys(a.experiments)), size), suite.tables)


def recording_plan(a: argparse.Namespace, out: Path) -> Plan:
    """Logs. Raises as `open_recordings`, and ValueError for an associator that nobody knows."""
    data = None if a.data is None else str(a.data)
    template = Log(a.recording, data, reference=a.reference, every=a.every, merge=a.merge, clean=a.clean)
    logs = logs_of(template, a.robots)
    for name, log in logs.items():
        print(f"{name}: {log.open().source} {log.open().terms}")
    searches = list(dict.fromkeys(a.relocation or [SEARCH]))
    return Plan(recording_evaluation(a.associators or shipped(), logs, out, searches), recordings.tables)


OPTIONS: dict[str, tuple[str, ...]] = {
    "association": (
        "scenarios",
        "floor_plan",
        "resolution",
        "overrides",
        "episodes",
        "first",
        "driver",
        "relocation",
        "rerun",
    ),
    "suite": ("quick", "experiments", "relocators", "worlds", "problems"),
    "recording": ("data", "robots", "every", "merge", "clean", "reference", "relocation"),
}
"""The options that only some evaluations know what to do with."""


def _refuse_what_does_not_apply(a: argparse.Namespace, kind: str) -> None:
    """ValueError for an option that would be ignored, as `--experiments` without `--suite`."""
    for other, names in OPTIONS.items():
        for name in set(names) - set(OPTIONS[kind]):
            if getattr(a, name) != parser().get_default(name):
                option = {"overrides": "set"}.get(name, name).replace("_", "-")
                meant = f"belongs to --{other}" if other != "association" else "is about drives through scenarios"
                instead = f", not to --{kind}" if kind != "association" else ", which was not asked for"
                raise ValueError(f"--{option} {meant}{instead}")


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    require_positive(a, "jobs", "worlds", "problems", "every")
    if a.suite and a.recording:
        raise ValueError("--suite and --recording are two evaluations: give one of them")
    require_rerun(a)
    kind, planned = ("suite", suite_plan) if a.suite else ("association", loop_plan)
    if a.recording:
        kind, planned = "recording", recording_plan
    _refuse_what_does_not_apply(a, kind)
    out, how = a.out or results_folder(kind, a.resume), execution(a, command_line("agents.evaluate_association", argv))
    try:
        plan = planned(a, out)
        results = carry_out(plan.evaluation, out, how)
        if a.rerun and plan.log:
            say_where(plan.log(a.rerun), how)
    except KeyboardInterrupt:
        how.console.print(f"interrupted; go on with the same command and --resume --out {out}", soft_wrap=True)
        raise
    for table in plan.tables(results):
        print_table(table, how.console)
    from agents.report import write_report  # matplotlib takes a second to import

    how.console.print(f"report: {write_report(out)}", soft_wrap=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
