"""Evaluate associators: `python -m agents.evaluate_association` puts each into the loop on the same test worlds;
`--suite` asks all of them about the same scans, one number per capability; `--recording` runs them over a real log.

Writes into OUT: results.csv (one row per episode), results.json (what it depends on) and report.html.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Literal

from typer import Option

from agents.cli import (
    ON_A_FLOOR,
    Episodes,
    Execute,
    Floor,
    Overrides,
    RerunFile,
    command,
    parsed_overrides,
    require_rerun,
    search_or_none,
)
from agents.drivers.base import AGENTS, make_agent
from agents.evaluation import recordings
from agents.evaluation.associators import metered, shipped
from agents.evaluation.drive_tables import associator_tables
from agents.evaluation.drives import associator_evaluation
from agents.evaluation.episodes import ExploreArguments
from agents.evaluation.pipeline import Evaluation, carry_out
from agents.evaluation.recordings import Log, logs_of, recording_evaluation
from agents.evaluation.tables import print_table
from agents.suite import numbers as suite_numbers
from agents.suite.worlds import SuiteSize, suite_evaluation
from slam_gym.association import RELOCATORS
from slam_gym.recordings.catalogue import PUBLISHED
from slam_gym.scenarios import SCENARIOS
from slam_gym.scenarios.suite import EXPERIMENTS
from slam_gym.slam.relocate import SEARCH

LOOPS = ("office-small", "hall", "crowd")
EPISODES = 30
SIZE, QUICK = SuiteSize(), SuiteSize(worlds=4, problems=8, quick=True)


Names = list[str] | None


@dataclass(frozen=True)
class Loop(Floor, Episodes):
    """Drives through scenarios."""

    scenarios: Annotated[Names, Option(help=f"Of {', '.join(SCENARIOS)}, or levels such as clutter/2.")] = None
    overrides: Overrides = None
    driver: Annotated[str, Option(help=f"Of {', '.join(AGENTS)}, or module:Class.")] = "information_gain"
    rerun: RerunFile = None


@dataclass(frozen=True)
class Suite:
    """The association suite."""

    quick: Annotated[bool, Option("--quick", help="Suite: every second level, few worlds.")] = False
    experiments: Annotated[Names, Option(help=f"Suite: of {', '.join(EXPERIMENTS)}; by default all.")] = None
    relocators: Annotated[Names, Option(help="Suite: whom kidnapped asks; by default all that ship.")] = None
    worlds: Annotated[int | None, Option(min=1, help=f"Suite: of a level; by default {SIZE.worlds}.")] = None
    problems: Annotated[int | None, Option(min=1, help=f"Suite: of a world; by default {SIZE.problems}.")] = None


@dataclass(frozen=True)
class Recorded:
    """What is done to a recording before it is mapped."""

    data: Annotated[Path | None, Option(help="Recording: its files, by default under SLAM_GYM_DATA.")] = None
    robots: Annotated[list[int] | None, Option(help="Recording: of mrclam, by default all.")] = None
    every: Annotated[int, Option(min=1, help="Recording: only each so many-th scan.")] = 1
    merge: Annotated[float, Option(min=0.0, help="Recording: landmarks no farther apart [m] are one.")] = 0.0
    clean: Annotated[bool, Option("--clean", help="Recording: leave out spurious measurements.")] = False
    reference: Annotated[bool, Option("--reference", help="Recording: vertices of a .g2o are the truth.")] = False


@dataclass(frozen=True)
class Candidates:
    """Who is evaluated: associators, and the searches that find a lost robot."""

    associators: Annotated[Names, Option(help=f"Of {', '.join(shipped())}, module:function or a model file.")] = None
    relocation: Annotated[Names, Option(help=f"Of {', '.join(RELOCATORS)}, module:function or none.")] = None
    split: Annotated[Literal["train", "test"], Option(help="Of the worlds; tune on train.")] = "test"

    @property
    def names(self) -> list[str]:
        """Of the associators."""
        return self.associators or shipped()

    def searches(self, default: list[str]) -> list[str | None]:
        """Each search once."""
        return [search_or_none(name) for name in dict.fromkeys(self.relocation or default)]


def main(
    candidates: Candidates,
    execute: Execute,
    loop: Loop,
    suite_options: Suite,
    recorded: Recorded,
    suite: Annotated[bool, Option("--suite", help="One number per capability instead of drives.")] = False,
    recording: Annotated[str | None, Option(help=f"A log: {', '.join(PUBLISHED)}, or .npz, .g2o, .txt (iSAM).")] = None,
) -> None:
    """Evaluate associators on the same drives, over the suite, or on a recording."""
    if suite and recording:
        raise ValueError("--suite and --recording are two evaluations: give one of them")
    require_rerun(loop.rerun)
    kind = "suite" if suite else "recording" if recording else "association"
    _refuse_what_does_not_apply(kind, {"association": loop, "suite": suite_options, "recording": recorded})
    if suite and candidates.relocation:
        raise ValueError("--relocation is not for --suite, whose searches --relocators names")
    out, how = execute.folder(kind), execute.execution()
    with execute.resumable(out):
        if suite:
            evaluation, tables = _suite_evaluation(candidates, suite_options), suite_numbers.tables
        elif recording:
            evaluation, tables = _recording_evaluation(candidates, recorded, recording, out), recordings.tables
        else:
            evaluation, tables = _loop_evaluation(candidates, loop), associator_tables
        results = carry_out(evaluation, out, how)
        if loop.rerun:
            _log_first_episodes(candidates, loop, loop.rerun)
    for table in tables(results):
        print_table(table, how.console)
    from agents.reports.page import write_report  # matplotlib takes a second to import

    how.console.print(f"report: {write_report(out)}", soft_wrap=True)


def _loop_evaluation(candidates: Candidates, loop: Loop) -> Evaluation:
    searches = candidates.searches(["none", SEARCH])
    return associator_evaluation(
        candidates.names, _loops(candidates, loop), loop.driver, loop.range(EPISODES), searches
    )


def _loops(candidates: Candidates, loop: Loop) -> list[ExploreArguments]:
    return [
        ExploreArguments(
            name, parsed_overrides(loop.overrides), candidates.split, floor_plan=loop.file, resolution=loop.resolution
        )
        for name in dict.fromkeys(loop.scenarios or ([ON_A_FLOOR] if loop.file else LOOPS))
    ]


def _log_first_episodes(candidates: Candidates, loop: Loop, target: str) -> None:
    """The first scenario, with the last of the searches."""
    from agents.reports.rerun_log import Drive, log_drives

    first = replace(_loops(candidates, loop)[0], relocation=candidates.searches(["none", SEARCH])[-1])
    drives = [Drive(name, first, make_agent(loop.driver), metered(name)[1]) for name in candidates.names]
    log_drives(target, loop.first, drives)


def _suite_evaluation(candidates: Candidates, options: Suite) -> Evaluation:
    size = QUICK if options.quick else SIZE
    size = SuiteSize(options.worlds or size.worlds, options.problems or size.problems, options.quick, candidates.split)
    experiments = list(dict.fromkeys(options.experiments or EXPERIMENTS))
    return suite_evaluation(candidates.names, options.relocators or list(RELOCATORS), experiments, size)


def _recording_evaluation(candidates: Candidates, options: Recorded, recording: str, out: Path) -> Evaluation:
    how = {name: getattr(options, name) for name in ("reference", "every", "merge", "clean")}
    logs = logs_of(Log(recording, str(options.data) if options.data else None, **how), options.robots)
    for name, log in logs.items():
        print(f"{name}: {log.open().source} {log.open().terms}")
    return recording_evaluation(candidates.names, logs, out, candidates.searches([SEARCH]))


def _refuse_what_does_not_apply(kind: str, groups: dict[str, Loop | Suite | Recorded]) -> None:
    """ValueError for an option that would be ignored, as `--experiments` without `--suite`."""
    for other, options in groups.items():
        for field in fields(options) if other != kind else ():
            if getattr(options, field.name) != field.default:
                option = {"overrides": "set"}.get(field.name, field.name).replace("_", "-")
                meant = "is about drives through scenarios" if other == "association" else f"belongs to --{other}"
                instead = ", which was not asked for" if kind == "association" else f", not to --{kind}"
                raise ValueError(f"--{option} {meant}{instead}")


app = command(main)
if __name__ == "__main__":
    app()
