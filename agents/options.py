"""Groups of options that commands share, as dataclasses: each field is an option (see `agents.cli.command`).

Only what a command does with them imports the package: `--help` answers at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from agents.evaluation.records import results_folder

if TYPE_CHECKING:
    from agents.evaluation.episodes import AssociateArguments, ExploreArguments

DRIFTING = ("office", "drift-1", "drift-2", "drift-3", "aliased-drift")
"""The scenarios in which an associator learns."""
ON_A_FLOOR = "building"
"""The scenario whose robot drives on a floor plan file."""

Names = list[str] | None
Scenarios = Annotated[Names, Option("--scenario", metavar="NAME", help="See slam-gym list scenarios. Repeatable.")]
Overrides = Annotated[Names, Option("--set", metavar="NAME=VALUE", help="Change the scenario. Repeatable.")]
Associators = Annotated[
    Names, Option(metavar="NAME …", help="See slam-gym list associators; or module:function, a model file.")
]


@dataclass(frozen=True)
class Scenes:
    """The scenarios that are driven through, or a floor plan file."""

    scenario: Scenarios = None
    overrides: Overrides = None
    floor_plan: Annotated[Path | None, Option(metavar="FILE", help="Drive here instead: JSON, or an image.")] = None
    resolution: Annotated[float | None, Option(metavar="M", help="Metres per pixel of an image.")] = None

    def loops(self, scenarios: Sequence[str], split: str, **others: Any) -> list[ExploreArguments]:
        """Arguments of Explore-v0 for each scenario; of these where the options name none."""
        from agents.evaluation.episodes import ExploreArguments

        floor = str(self.floor_plan.resolve()) if self.floor_plan else None
        names, changes = self.scenario or ([ON_A_FLOOR] if floor else scenarios), parsed_overrides(self.overrides)
        shared = {"floor_plan": floor, "resolution": self.resolution, **others}
        return [ExploreArguments(name, changes, split, **shared) for name in dict.fromkeys(names)]


@dataclass(frozen=True)
class World(Scenes):
    """Scenes, and the SLAM in them."""

    associator: Annotated[str | None, Option(metavar="NAME", help="By default that of the scenario.")] = None
    relocation: Annotated[str | None, Option(metavar="NAME", help="Finds a lost robot; or none.")] = None

    def loops(self, scenarios: Sequence[str], split: str, **others: Any) -> list[ExploreArguments]:
        slam = {"associator": self.associator, "relocation": search_of(self.relocation)}
        return super().loops(scenarios, split, **slam, **others)

    def arguments(self, scenario: str, split: str, reward: str = "map_error") -> ExploreArguments:
        """Of the one scenario. ValueError where several are named."""
        loops = self.loops([scenario], split, reward=reward)
        if len(loops) > 1:
            raise ValueError(f"--scenario: one is enough here, not {' and '.join(loop.scenario for loop in loops)}")
        return loops[0]


@dataclass(frozen=True)
class Episodes:
    """Which episodes are run."""

    episodes: Annotated[int | None, Option(min=1, metavar="N", help="How many.", show_default=False)] = None
    seed: Annotated[int, Option(min=0, metavar="K", help="Of the first: episode k is world k with seed k.")] = 0

    def range(self, default: int) -> range:
        """Their numbers."""
        return range(self.seed, self.seed + (self.episodes or default))


@dataclass(frozen=True)
class AssociateWorld:
    """What chooses the episodes of Associate-v0; by default those of scenarios with good and with bad wheels."""

    scenario: Scenarios = None
    overrides: Overrides = None
    driver: Annotated[str, Option(help="nearest_frontier or random.")] = "nearest_frontier"
    reward: Annotated[str, Option(help="truth or map_error.")] = "truth"
    candidates: Annotated[int, Option(min=1, metavar="K", help="Features on offer for a measurement.")] = 5
    order: Annotated[str, Option(help="Of the measurements.")] = "as_scanned"
    compatibility: Annotated[str, Option(help="joint or individual.")] = "joint"
    wrong_cost: Annotated[float, Option(metavar="C", help="Of a wrong pairing.")] = 10.0

    def worlds(self, split: str) -> list[AssociateArguments]:
        """Arguments of the environment for each scenario."""
        from agents.evaluation.episodes import AssociateArguments

        own = {field.name: getattr(self, field.name) for field in fields(self)}
        own |= {"overrides": parsed_overrides(self.overrides), "split": split}
        return [AssociateArguments(**own | {"scenario": name}) for name in self.scenario or DRIFTING]


@dataclass(frozen=True)
class Execution:
    """How an evaluation is done, and where its files go."""

    jobs: Annotated[int | None, Option(min=1, metavar="J", help="Processes; by default one a core.")] = None
    output: Annotated[Path | None, Option(metavar="DIR", help="By default a new folder in results/.")] = None
    resume: Annotated[bool, Option("--resume", help="Go on where an evaluation was interrupted.")] = False

    def folder(self, name: str) -> Path:
        """Where the files go. ValueError where there is nothing to resume."""
        return self.output or results_folder(name, self.resume)


@dataclass(frozen=True)
class Suite:
    """How much of the association suite is run."""

    quick: Annotated[bool, Option("--quick", help="Suite: every second level, few worlds.")] = False
    experiments: Annotated[Names, Option(metavar="NAME …", help="Suite: such as clutter; by default all.")] = None
    worlds: Annotated[int | None, Option(min=1, metavar="N", help="Suite: of a level; by default 24.")] = None
    problems: Annotated[int | None, Option(min=1, metavar="N", help="Suite: of a world; by default 12.")] = None


@dataclass(frozen=True)
class Recorded:
    """What is done to a recording before it is mapped."""

    data: Annotated[Path | None, Option(help="Recording: its files, by default under SLAM_GYM_DATA.")] = None
    robots: Annotated[list[int] | None, Option(help="Recording: of mrclam, by default all.")] = None
    every: Annotated[int, Option(min=1, help="Recording: only each so many-th scan.")] = 1
    reference: Annotated[bool, Option("--reference", help="Recording: vertices of a .g2o are the truth.")] = False


@dataclass(frozen=True)
class Training:
    """How long, from which seed and with what a policy is trained."""

    timesteps: Annotated[int | None, Option(min=1, metavar="N", help="Decisions; by default as in FILE.")] = None
    seed: Annotated[int, Option(min=0, metavar="K")] = 0
    output: Annotated[Path | None, Option(metavar="DIR", help="By default a folder in runs/.")] = None
    resume: Annotated[bool, Option("--resume", help="Go on in DIR, up to --timesteps.")] = False
    hyperparameters: Annotated[Path | None, Option(metavar="FILE", help="TOML; by default those that ship.")] = None
    envs: Annotated[int | None, Option(min=1, metavar="N", help="Environments; by default as in FILE.")] = None
    processes: Annotated[bool, Option("--processes", help="Give each environment a process of its own.")] = False
    eval_every: Annotated[int | None, Option(min=1, metavar="N", help="Decisions between evaluations.")] = None
    eval_episodes: Annotated[int, Option(min=1, metavar="N", help="Held-out worlds.")] = 10


def parsed_overrides(texts: Sequence[str] | None) -> tuple[tuple[str, Any], ...]:
    """Names and values of NAME=VALUE. ValueError for anything else."""
    from slam_gym.scenarios import parse_override

    return tuple(parse_override(text) for text in texts or ())


def search_of(text: str | None) -> str | None:
    """The name of a search that finds a lost robot: the default unless another is named; `none` is none."""
    from slam_gym.slam.relocate import SEARCH

    return None if text == "none" else text or SEARCH
