"""What the commands share: typer commands whose groups of options are dataclasses, and how an evaluation is run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from rich.console import Console
from typer import Option

from agents.evaluation.episodes import AssociateArguments, ExploreArguments
from agents.evaluation.pipeline import Evaluation, Execution, carry_out
from agents.evaluation.tables import print_table
from slam_gym.commands.run import ended
from slam_gym.scenarios import parse_override
from slam_gym.slam.relocate import SEARCH

ON_A_FLOOR = "building"
"""The scenario whose robot drives on a floor plan file."""


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
        raise typer.Exit(ended(lambda: function(**values)) or 0)

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
        repeated = {name for p in self.params if getattr(p, "multiple", False) for name in p.opts}
        option, values, spread = "", 0, []
        for word in args:
            if word.startswith("-"):
                option, values = word, 0
            else:
                spread += [option] if option in repeated and values else []
                values += 1
            spread.append(word)
        return super().parse_args(ctx, spread)


Overrides = Annotated[list[str] | None, Option("--set", metavar="NAME=VALUE", help="Change the scenario. Repeatable.")]


@dataclass(frozen=True)
class Floor:
    """A floor plan file to drive on."""

    floor_plan: Annotated[Path | None, Option(metavar="FILE", help="Drive here instead: JSON, or an image.")] = None
    resolution: Annotated[float | None, Option(metavar="M", help="Metres per pixel of an image.")] = None

    @property
    def file(self) -> str | None:
        """The path of the plan, from the root."""
        return str(self.floor_plan.resolve()) if self.floor_plan else None


@dataclass(frozen=True)
class World(Floor):
    """What chooses the world of Explore-v0 and its SLAM."""

    scenario: Annotated[str | None, Option(metavar="NAME", help="A scenario, or module:name of your own.")] = None
    overrides: Overrides = None
    associator: Annotated[str | None, Option(metavar="NAME", help="By default that of the scenario.")] = None
    relocation: Annotated[str, Option(metavar="SEARCH", help="Finds a lost robot: a name, or none.")] = SEARCH

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
    first: Annotated[int, Option(min=0, metavar="K", help="Episode k is that of world k and seed k.")] = 0

    def range(self, default: int) -> range:
        """Their numbers."""
        return range(self.first, self.first + (self.episodes or default))


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


def search_or_none(text: str) -> str | None:
    """The name of a search; `none` is none."""
    return None if text == "none" else text


def evaluate(evaluation: Evaluation, execution: Execution, out: Path, films: Callable[[], None] | None = None) -> None:
    """Carry it out, make its films, print its tables, and write its report.

    Where it is interrupted, say how to go on.
    """
    try:
        results = carry_out(evaluation, out, execution)
        if films:
            films()
    except KeyboardInterrupt:
        print(f"interrupted; go on with the same command and --resume --out {out}")
        raise
    from agents.reports.page import page_of, write_report  # matplotlib takes a second to import

    for table in page_of(results, out).tables:
        print_table(table, Console())
    print(f"report: {write_report(out)}")
