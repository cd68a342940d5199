"""Groups of options that commands share, as dataclasses: each field is an option (see `agents.cli.command`).

The package is imported only when a command uses its options, so that `--help` is fast.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Option

from agents.evaluation.records import results_folder

if TYPE_CHECKING:
    from agents.evaluation.episodes import AssociateArguments, ExploreArguments

DRIFTING = ("office", "drift-1", "drift-2", "drift-3", "aliased-drift")
"""The scenarios in which an associator is trained."""

Role = Literal["agent", "associator", "relocator"]
"""What an entry of the leaderboard is."""
Names = list[str] | None
Scenarios = Annotated[Names, Option("--scenario", metavar="NAME", help="See slam-gym list scenarios. Repeatable.")]
Overrides = Annotated[Names, Option("--set", metavar="NAME=VALUE", help="Change the scenario. Repeatable.")]
Associators = Annotated[
    Names, Option(metavar="NAME …", help="See slam-gym list associators; or module:function, a model file.")
]
Search = Annotated[str | None, Option(metavar="NAME", help="Search that finds a lost robot, by default gcbb; or none.")]


@dataclass(frozen=True)
class Scenes:
    """The scenarios of the drives, or a floor plan file."""

    scenario: Scenarios = None
    overrides: Overrides = None
    floor_plan: Annotated[Path | None, Option(metavar="FILE", help="Drive here instead: JSON, or an image.")] = None
    resolution: Annotated[float | None, Option(metavar="M", help="Metres per pixel of an image.")] = None

    def loops(self, scenarios: Sequence[str], split: str, **others: Any) -> "list[ExploreArguments]":
        """Arguments of Explore-v0 for each scenario of the options, or else of `scenarios`."""
        from agents.evaluation.episodes import ON_A_FLOOR, ExploreArguments

        floor = str(self.floor_plan.resolve()) if self.floor_plan else None
        names, changes = self.scenario or ([ON_A_FLOOR] if floor else scenarios), parsed_overrides(self.overrides)
        shared = {"floor_plan": floor, "resolution": self.resolution, **others}
        return [ExploreArguments(name, changes, split, **shared) for name in dict.fromkeys(names)]


@dataclass(frozen=True)
class ExploreWorld(Scenes):
    """Scenes, with options for SLAM."""

    associator: Annotated[str | None, Option(metavar="NAME", help="By default that of the scenario.")] = None
    relocation: Search = None

    def loops(self, scenarios: Sequence[str], split: str, **others: Any) -> "list[ExploreArguments]":
        slam = {"associator": self.associator, "relocation": search_of(self.relocation)}
        return super().loops(scenarios, split, **slam, **others)

    def arguments(self, scenario: str, split: str, reward: str = "map_error") -> "ExploreArguments":
        """The arguments for one scenario. Raises ValueError where several are named."""
        loops = self.loops([scenario], split, reward=reward)
        if len(loops) > 1:
            raise ValueError(f"--scenario: one is enough here, not {' and '.join(loop.scenario for loop in loops)}")
        return loops[0]


@dataclass(frozen=True)
class Episodes:
    """The numbers of the episodes."""

    episodes: Annotated[
        int | None, Option(min=1, metavar="N", help="By default 4; evaluate-association 30, record-decisions 10.")
    ] = None
    seed: Annotated[int, Option(min=0, metavar="K", help="First episode; episode k is world k with seed k.")] = 0

    def range(self, default: int, split: str = "test") -> range:
        """The numbers, by default `default` of them. Raises ValueError beyond the worlds of `split`."""
        from slam_gym.scenarios import world_seed

        numbers = range(self.seed, self.seed + (self.episodes or default))
        world_seed(split, numbers[-1])
        return numbers


@dataclass(frozen=True)
class AssociateWorld:
    """The environment Associate-v0, by default in scenarios with small and with large drift."""

    scenario: Scenarios = None
    overrides: Overrides = None
    driver: Annotated[str, Option(help="nearest_frontier or random.")] = "nearest_frontier"
    reward: Annotated[str, Option(help="truth or map_error.")] = "truth"
    candidates: Annotated[int, Option(min=1, metavar="K", help="Features on offer for a measurement.")] = 5
    order: Annotated[str, Option(help="as_scanned, nearest_first or fewest_candidates.")] = "as_scanned"
    compatibility: Annotated[str, Option(help="joint or individual.")] = "joint"
    wrong_cost: Annotated[float, Option(metavar="C", help="Cost of a wrong pairing.")] = 10.0

    def worlds(self, split: str) -> "list[AssociateArguments]":
        """Arguments of the environment for each scenario."""
        from agents.evaluation.episodes import AssociateArguments

        arguments = vars(self) | {"overrides": parsed_overrides(self.overrides), "split": split}
        return [AssociateArguments(**arguments | {"scenario": name}) for name in self.scenario or DRIFTING]


@dataclass(frozen=True)
class Execution:
    """The execution of an evaluation, and the folder of its files."""

    jobs: Annotated[int | None, Option(min=1, metavar="J", help="Processes; by default one per core.")] = None
    output: Annotated[
        Path | None, Option(metavar="DIR", help="By default a new folder in results/; leaderboard: in --board.")
    ] = None
    resume: Annotated[bool, Option("--resume", help="Go on where an evaluation was interrupted.")] = False

    def folder(self, name: str) -> Path:
        """The folder of the files. Raises ValueError where there is nothing to resume."""
        return self.output or results_folder(name, self.resume)


@dataclass(frozen=True)
class Suite:
    """The part of the association suite that is run."""

    quick: Annotated[bool, Option("--quick", help="Suite: every second level, few worlds.")] = False
    experiments: Annotated[
        Names, Option(metavar="NAME …", help="Suite: experiments such as clutter; by default all.")
    ] = None
    worlds: Annotated[int | None, Option(min=1, metavar="N", help="Suite: worlds per level; by default 24.")] = None
    problems: Annotated[int | None, Option(min=1, metavar="N", help="Suite: problems per world; by default 12.")] = None


@dataclass(frozen=True)
class Recorded:
    """The preparation of a recording."""

    data: Annotated[Path | None, Option(help="Recording: folder of its files, by default SLAM_GYM_DATA.")] = None
    robots: Annotated[list[int] | None, Option(help="Recording: robots of mrclam, by default all.")] = None
    every: Annotated[int, Option(min=1, help="Recording: use only every N-th scan.")] = 1
    reference: Annotated[bool, Option("--reference", help="Recording: the vertices of a .g2o are the truth.")] = False


@dataclass(frozen=True)
class Training:
    """The training of a policy: length, seed and hyperparameters."""

    timesteps: Annotated[int | None, Option(min=1, metavar="N", help="Decisions; by default as in FILE.")] = None
    seed: Annotated[int, Option(min=0, metavar="K", help="Of the networks and the worlds.")] = 0
    output: Annotated[Path | None, Option(metavar="DIR", help="By default runs/drive or runs/associate.")] = None
    resume: Annotated[bool, Option("--resume", help="Continue in DIR, up to --timesteps.")] = False
    hyperparameters: Annotated[Path | None, Option(metavar="FILE", help="TOML; by default the shipped file.")] = None
    envs: Annotated[int | None, Option(min=1, metavar="N", help="Environments; by default as in FILE.")] = None
    processes: Annotated[bool, Option("--processes", help="Give each environment a process of its own.")] = False
    eval_every: Annotated[int | None, Option(min=1, metavar="N", help="Decisions between evaluations.")] = None
    eval_episodes: Annotated[int, Option(min=1, metavar="N", help="Held-out worlds.")] = 10


def parsed_overrides(texts: Sequence[str] | None) -> tuple[tuple[str, Any], ...]:
    """The names and values of texts NAME=VALUE. Raises ValueError for any other text."""
    from slam_gym.scenarios import parse_override

    return tuple(parse_override(text) for text in texts or ())


def search_of(text: str | None) -> str | None:
    """The name of a relocation search: the default for None, and None for `none`."""
    from slam_gym.slam.relocate import SEARCH

    return None if text == "none" else text or SEARCH
