"""What the commands share: options, folders of results, and errors told in one line."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from datetime import datetime
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import joblib
import typer
from rich.console import Console
from typer import Option

from agents.evaluation.episodes import AssociateArguments, ExploreArguments
from agents.evaluation.parallel import BACKENDS
from agents.evaluation.pipeline import Execution
from agents.evaluation.records import stem
from slam_gym.commands.run import ended
from slam_gym.scenarios import parse_override
from slam_gym.slam.relocate import SEARCH

ON_A_FLOOR = "building"
"""The scenario whose robot drives on a floor plan file."""


def add_override_option(group: Any) -> None:
    """--set NAME=VALUE, as often as one likes."""
    group.add_argument("--set", action="append", default=[], type=_override, metavar="NAME=VALUE", dest="overrides",
                       help="change the scenario, such as sensor.range=4 or dynamics.people=3; repeatable")  # fmt: skip


def _override(text: str) -> tuple[str, Any]:
    try:
        return parse_override(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def add_explore_options(parser: argparse.ArgumentParser, scenario: str) -> None:
    """What chooses the world and its SLAM."""
    world = parser.add_argument_group("world")
    parser.set_defaults(default_scenario=scenario)
    world.add_argument("--scenario", help="name of a scenario, or module:name of one of your own "
                       f"(default: {scenario}; of a floor plan {ON_A_FLOOR})")  # fmt: skip
    add_override_option(world)
    add_floor_options(world)
    world.add_argument("--associator", help="name or module:function (default: that of the scenario)")
    world.add_argument("--relocation", type=search_or_none, default=SEARCH, metavar="SEARCH", help="that finds a "
                       "lost robot: gcbb, module:function …, or none (default: %(default)s)")  # fmt: skip


def add_floor_options(group: Any) -> None:
    """--floor-plan FILE and --resolution M."""
    group.add_argument("--floor-plan", metavar="FILE", help="drive on this floor instead: JSON, or an occupancy image")
    group.add_argument("--resolution", type=float, metavar="M", help="metres per pixel of an occupancy image")


def add_episode_options(group: Any, default: int, of: str) -> None:
    """--episodes N and --first K."""
    group.add_argument("--episodes", type=int, default=default, metavar="N", help=f"{of} (default: %(default)s)")
    group.add_argument("--first", type=int, default=0, metavar="K", help="the first of them: episode k is that of "
                       "world k and seed k (default: %(default)s)")  # fmt: skip


def episodes_of(a: argparse.Namespace) -> range:
    """The episodes that the options above choose. ValueError where the first is negative, or there is none."""
    require_positive(a, "episodes")
    if a.first < 0:
        raise ValueError(f"--first must be at least 0, not {a.first}")
    return range(a.first, a.first + a.episodes)


def add_rerun_option(group: Any) -> None:
    """--rerun FILE|spawn."""
    group.add_argument("--rerun", metavar="FILE", help="write first episodes for Rerun's viewer into FILE (.rrd), or "
                       "spawn it (needs rerun-sdk)")  # fmt: skip


def require_rerun(a: argparse.Namespace) -> None:
    """ImportError where --rerun is asked for and its package is missing: now, not after hours."""
    if a.rerun:
        from agents.reports.rerun_log import viewer

        viewer()


def say_where(files: Sequence[str], how: Execution) -> None:
    """Tell which files there are now for Rerun's viewer."""
    for file in files:
        how.console.print(f"rerun: {file}", soft_wrap=True)


def search_or_none(text: str) -> str | None:
    """The name of a search; `none` is none."""
    return None if text == "none" else text


def explore_arguments(a: argparse.Namespace, **more: str) -> ExploreArguments:
    """What the options above choose."""
    plan = str(Path(a.floor_plan).resolve()) if a.floor_plan else None
    scenario = a.scenario or (ON_A_FLOOR if plan else a.default_scenario)
    return ExploreArguments(
        scenario, tuple(a.overrides), associator=a.associator, floor_plan=plan, resolution=a.resolution,
        relocation=a.relocation, **more,
    )  # fmt: skip


def add_associate_options(parser: argparse.ArgumentParser) -> None:
    """What chooses an episode of Associate-v0, but for the split."""
    group = parser.add_argument_group("environment (see slam_gym/Associate-v0)")
    default = AssociateArguments()
    group.add_argument("--scenario", default=default.scenario, help="a scenario, or corridor (default: %(default)s)")
    add_override_option(group)
    group.add_argument("--driver", default=default.driver, help="nearest_frontier or random (default: %(default)s)")
    group.add_argument("--reward", default=default.reward, help="truth or map_error (default: %(default)s)")
    group.add_argument("--candidates", type=int, default=default.candidates, metavar="K", help="default: %(default)s")
    group.add_argument("--order", default=default.order, help="of the measurements (default: %(default)s)")
    group.add_argument("--compatibility", default=default.compatibility, help="joint or individual")
    group.add_argument("--wrong-cost", type=float, default=default.wrong_cost, metavar="C", help="default: %(default)s")


def associate_arguments(a: argparse.Namespace, split: str) -> AssociateArguments:
    """What the options above choose."""
    names = ("scenario", "driver", "reward", "candidates", "order", "compatibility", "wrong_cost")
    return AssociateArguments(overrides=tuple(a.overrides), split=split, **{name: getattr(a, name) for name in names})


def add_execution_options(parser: argparse.ArgumentParser, folder: str) -> None:
    """How an evaluation is carried out, and where its files go."""
    parser.add_argument("--jobs", type=int, default=joblib.cpu_count(), metavar="J",
                        help="processes (default: %(default)s)")  # fmt: skip
    parser.add_argument("--backend", default="loky", choices=BACKENDS, help="of joblib (default: %(default)s)")
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"default: {folder}")
    parser.add_argument("--resume", action="store_true", help="go on with an interrupted evaluation (default: the "
                        "latest)")  # fmt: skip


def execution(a: argparse.Namespace, command: str) -> Execution:
    """What the options above choose."""
    return Execution(a.jobs, a.backend, command, a.resume, Console())


def require_positive(a: argparse.Namespace, *names: str) -> None:
    """ValueError for an option that is given and less than 1."""
    for name in names:
        value = getattr(a, name)
        if value is not None and value < 1:
            raise ValueError(f"--{name.replace('_', '-')} must be at least 1, not {value}")


def results_folder(name: str, resume: bool) -> Path:
    """A new folder under results/ of the current directory, or the latest one of that name."""
    results, name = Path("results"), stem(name)
    if not resume:
        return results / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
    folders = sorted(results.glob(f"{name}-[0-9]*"))
    if not folders:
        raise ValueError(f"there is no evaluation of {name} to resume in {results.resolve()}: give its folder with "
                         "--out")  # fmt: skip
    return folders[-1]


def run_main(main: Callable[[list[str]], int]) -> int:
    """Run a command with the arguments of this process; its exit code, as `slam_gym.commands.run.ended` has it."""
    return ended(lambda: main(sys.argv[1:]))


def program(module: str) -> str:
    """How a command was called: `slam-gym train`, or `python -m agents.train`."""
    if Path(sys.argv[0]).stem in ("slam-gym", "__main__") and module.startswith("agents."):
        return f"slam-gym {module.removeprefix('agents.').replace('_', '-')}"
    return f"python -m {module}"


def command_line(module: str, argv: list[str]) -> str:
    """The command as it would be typed."""
    return " ".join([program(module), *map(shlex.quote, argv)])


# -- options as dataclasses, commands by typer -------------------------------------------------------------------------


def command(function: Callable[..., int | None]) -> typer.Typer:
    """The command of a function: `app = command(main)`, called by `python -m` and by `slam-gym`.

    A parameter that is a dataclass, such as `World`, stands for the options that its fields are. An option that takes
    several values takes them in a row, as in `--agents random learned`. Bad input ends in one line and exit code 2.
    """
    hints = get_type_hints(function, include_extras=True)
    groups = {name: hint for name, hint in hints.items() if is_dataclass(hint)}

    def call(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        raise typer.Exit(ended(lambda: function(**values) or 0))

    parameters: list[Parameter] = []
    for parameter in signature(function).parameters.values():
        if (group := groups.get(parameter.name)) is not None:
            parameters += signature(group).parameters.values()
            hints |= get_type_hints(group, include_extras=True)
        else:
            parameters.append(parameter)
    parameters = [p.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[p.name]) for p in parameters]
    call.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command(help=function.__doc__, cls=_SeveralValues)(call)
    return app


class _SeveralValues(typer.core.TyperCommand):
    """A command whose options that may be repeated also take several values in a row."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:
        repeated = {
            name for parameter in self.params if getattr(parameter, "multiple", False) for name in parameter.opts
        }
        option, values, spread = "", 0, []
        for word in args:
            if word.startswith("-"):
                option, values = word, 0
            else:
                spread += [option] if option in repeated and values else []
                values += 1
            spread.append(word)
        return super().parse_args(ctx, spread)


def typed() -> str:
    """The command that runs, as it was typed: `slam-gym train …`, or `python -m agents.train …`."""
    program = Path(sys.argv[0])
    name = "slam-gym" if program.stem in ("slam-gym", "__main__") else f"python -m agents.{program.stem}"
    return f"{name} {shlex.join(sys.argv[1:])}"


Overrides = Annotated[
    list[str] | None,
    Option("--set", metavar="NAME=VALUE", help="Change the scenario, as in sensor.range=4. Repeatable."),
]
Associator = Annotated[
    str | None, Option(metavar="NAME", help="Name or module:function; by default that of the scenario.")
]
RerunFile = Annotated[
    str | None,
    Option("--rerun", metavar="FILE", help="Write first episodes for Rerun's viewer into FILE (.rrd), or spawn it."),
]


@dataclass(frozen=True)
class Floor:
    """A floor plan file to drive on."""

    floor_plan: Annotated[
        Path | None, Option(metavar="FILE", help="Drive on this floor instead: JSON, or an occupancy image.")
    ] = None
    resolution: Annotated[float | None, Option(metavar="M", help="Metres per pixel of an occupancy image.")] = None

    @property
    def file(self) -> str | None:
        """The path of the plan, from the root."""
        return str(self.floor_plan.resolve()) if self.floor_plan else None


@dataclass(frozen=True)
class World(Floor):
    """What chooses the world of Explore-v0 and its SLAM."""

    scenario: Annotated[str | None, Option(metavar="NAME", help="A scenario, or module:name of one of your own.")] = (
        None
    )
    overrides: Overrides = None
    associator: Associator = None
    relocation: Annotated[
        str, Option(metavar="SEARCH", help="What finds a lost robot: gcbb, module:function …, or none.")
    ] = SEARCH

    def arguments(self, scenario: str, split: str, reward: str = "map_error") -> ExploreArguments:
        """Arguments of the environment; of this scenario where the options name none."""
        return ExploreArguments(
            scenario=self.scenario or (ON_A_FLOOR if self.file else scenario),
            overrides=parsed_overrides(self.overrides),
            split=split,
            associator=self.associator,
            reward=reward,
            floor_plan=self.file,
            resolution=self.resolution,
            relocation=search_or_none(self.relocation),
        )


@dataclass(frozen=True)
class Episodes:
    """Which episodes are run."""

    episodes: Annotated[int | None, Option(min=1, metavar="N", help="How many.", show_default=False)] = None
    first: Annotated[
        int, Option(min=0, metavar="K", help="The first of them: episode k is that of world k and seed k.")
    ] = 0

    def range(self, default: int) -> range:
        """Their numbers."""
        return range(self.first, self.first + (self.episodes or default))


@dataclass(frozen=True)
class Execute:
    """How an evaluation is carried out, and where its files go."""

    jobs: Annotated[int, Option(min=1, metavar="J", help="Processes.")] = joblib.cpu_count()
    backend: Annotated[Literal["loky", "multiprocessing", "ray", "dask"], Option(help="Of joblib.")] = "loky"
    out: Annotated[Path | None, Option(metavar="DIR", help="By default a new folder in results/.")] = None
    resume: Annotated[bool, Option("--resume", help="Go on with an interrupted evaluation, by default the latest.")] = (
        False
    )

    def folder(self, name: str) -> Path:
        """Where the files go. ValueError where there is nothing to resume."""
        return self.out or results_folder(name, self.resume)


@dataclass(frozen=True)
class AssociateWorld:
    """What chooses an episode of Associate-v0."""

    scenario: Annotated[str, Option(metavar="NAME", help="A scenario, or corridor.")] = "office-small"
    overrides: Overrides = None
    driver: Annotated[str, Option(help="nearest_frontier or random.")] = "nearest_frontier"
    reward: Annotated[str, Option(help="truth or map_error.")] = "truth"
    candidates: Annotated[int, Option(min=1, metavar="K", help="Features on offer for a measurement.")] = 5
    order: Annotated[str, Option(help="Of the measurements.")] = "as_scanned"
    compatibility: Annotated[str, Option(help="joint or individual.")] = "joint"
    wrong_cost: Annotated[float, Option(metavar="C", help="Of a wrong pairing.")] = 10.0

    def arguments(self, split: str) -> AssociateArguments:
        """Arguments of the environment."""
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        return AssociateArguments(**(own | {"overrides": parsed_overrides(self.overrides), "split": split}))


def parsed_overrides(texts: Sequence[str] | None) -> tuple[tuple[str, Any], ...]:
    """Names and values of NAME=VALUE. ValueError for anything else."""
    return tuple(parse_override(text) for text in texts or ())
