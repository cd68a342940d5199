"""Evaluate associators: `python -m agents.evaluate_association` puts each into the loop on the same test worlds;
`--suite` asks all of them about the same scans, one number per capability; `--recording` runs them over a real log.

Writes into OUT: results.csv (one row per episode), results.json (what it depends on) and report.html.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

from typer import Option

from agents.cli import (
    ON_A_FLOOR,
    Episodes,
    Floor,
    Overrides,
    command,
    evaluate,
    parsed_overrides,
    search_or_none,
)
from agents.drivers.base import AGENTS
from agents.evaluation.associators import SHIPPED
from agents.evaluation.drives import associator_evaluation
from agents.evaluation.episodes import ExploreArguments
from agents.evaluation.pipeline import Evaluation, Execution
from agents.evaluation.recordings import Recorded, recording_evaluation
from agents.suite.worlds import Names, Suite
from slam_gym.association import RELOCATORS
from slam_gym.recordings.catalogue import PUBLISHED
from slam_gym.scenarios import SCENARIOS
from slam_gym.slam.relocate import SEARCH

LOOPS = ("office-small", "hall", "crowd")
EPISODES = 30


@dataclass(frozen=True)
class Loop(Floor, Episodes):
    """Drives through scenarios."""

    scenarios: Annotated[Names, Option(help=f"Of {', '.join(SCENARIOS)}, or levels such as clutter/2.")] = None
    overrides: Overrides = None
    driver: Annotated[str, Option(help=f"Of {', '.join(AGENTS)}, or module:Class.")] = "information_gain"

    def arguments(self, split: str) -> list[ExploreArguments]:
        """Of the environment of each scenario."""
        changes = parsed_overrides(self.overrides)
        return [
            ExploreArguments(name, changes, split, floor_plan=self.file, resolution=self.resolution)
            for name in dict.fromkeys(self.scenarios or ([ON_A_FLOOR] if self.file else LOOPS))
        ]


@dataclass(frozen=True)
class Candidates:
    """Who is evaluated: associators, and the searches that find a lost robot."""

    associators: Annotated[Names, Option(help=f"Of {', '.join(SHIPPED)}, module:function or a model file.")] = None
    relocation: Annotated[Names, Option(help=f"Of {', '.join(RELOCATORS)}, module:function or none.")] = None
    split: Annotated[Literal["train", "test"], Option(help="Of the worlds; tune on train.")] = "test"

    @property
    def names(self) -> list[str]:
        """Of the associators."""
        return self.associators or list(SHIPPED)

    def searches(self, default: list[str]) -> list[str | None]:
        """Each search once."""
        return [search_or_none(name) for name in dict.fromkeys(self.relocation or default)]


def main(
    candidates: Candidates,
    execution: Execution,
    loop: Loop,
    suite_options: Suite,
    recorded: Recorded,
    suite: Annotated[bool, Option("--suite", help="One number per capability instead of drives.")] = False,
    recording: Annotated[
        str | None, Option(help=f"A log: {', '.join(PUBLISHED)}, or .csv, .npz, .g2o, .txt (iSAM).")
    ] = None,
) -> None:
    """Evaluate associators on the same drives, over the suite, or on a recording."""
    if suite and recording:
        raise ValueError("--suite and --recording are two evaluations: give one of them")
    kind = "suite" if suite else "recording" if recording else "association"
    _refuse_what_does_not_apply(kind, {"association": loop, "suite": suite_options, "recording": recorded})
    out = execution.folder(kind)
    if suite:
        if candidates.relocation:
            raise ValueError("--relocation is not for --suite, whose searches --relocators names")
        evaluate(suite_options.evaluation(candidates.names, candidates.split), execution, out)
    elif recording:
        evaluate(_on_logs(candidates, recorded, recording, out), execution, out)
    else:
        arguments, searches = loop.arguments(candidates.split), candidates.searches(["none", SEARCH])
        episodes = loop.range(EPISODES)
        evaluation = associator_evaluation(candidates.names, arguments, loop.driver, episodes, searches)
        evaluate(evaluation, execution, out)


def _on_logs(candidates: Candidates, recorded: Recorded, recording: str, out: Path) -> Evaluation:
    logs = recorded.logs(recording)
    for log in logs:
        print(f"{log.name}: {log.source} {log.terms}")
    conditions = {"recording": recording} | recorded.conditions
    return recording_evaluation(candidates.names, logs, conditions, out, candidates.searches([SEARCH]))


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
