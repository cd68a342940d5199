"""Shared code of the commands: typer commands whose groups of options are dataclasses, and running an evaluation."""

import sys
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import fields, is_dataclass
from functools import partial
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from agents.options import Execution

if TYPE_CHECKING:
    from agents.evaluation.pipeline import Evaluation

_EXTRAS = dict.fromkeys(("imageio", "jinja2", "joblib", "matplotlib", "pandas", "rich", "threadpoolctl"), "agents")
_EXTRAS |= dict.fromkeys(("torch", "stable_baselines3", "sb3_contrib", "tensorboard"), "learn") | {"minari": "minari"}
"""The extra that installs a module."""


def command(
    name: str, function: Callable[..., int | None], example: str, app: typer.Typer | None = None
) -> typer.Typer:
    """The typer app of a function, or the given `app` of several; `example` are options, shown at the end of its help.

    A parameter that is a dataclass, such as `ExploreWorld`, is replaced by options for its fields. An option with
    several values takes them in a row, as in `--agents random learned`. Invalid input ends with one line of text and
    exit code 2.
    """
    groups: dict[str, Any] = {}
    parameters: list[Parameter] = []
    for parameter in signature(function, eval_str=True).parameters.values():
        if is_dataclass(group := parameter.annotation):
            groups[parameter.name] = group
            parameters += signature(group).parameters.values()
        else:
            parameters.append(parameter)

    def call(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        raise typer.Exit(ended(lambda: function(**values)) or 0)

    options = [parameter.replace(kind=Parameter.KEYWORD_ONLY) for parameter in parameters]
    call.__signature__ = Signature(options)  # type: ignore[attr-defined]
    path = f"{app.info.name} {name}" if app else name
    app = app or typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    epilog = f"Example: slam-gym {path} {example}"
    app.command(name, help=function.__doc__, epilog=epilog, cls=_SeveralValues)(call)
    return app


class _SeveralValues(typer.core.TyperCommand):
    """A command whose repeatable options also take several values in a row."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:
        repeated = {name for p in self.params if getattr(p, "multiple", False) for name in p.opts}
        option, expanded = "", list[str]()
        for word in args:
            if word.startswith("-"):
                option = word
            elif option in repeated and expanded[-1] != option:
                expanded.append(option)  # a further value
            expanded.append(word)
        return super().parse_args(ctx, expanded)


def ended(command: Callable[[], int | None]) -> int | None:
    """The result of a command. Bad input, a missing package, a full disk or a killed worker end the process with one
    line on stderr and exit code 2; Ctrl-C ends it with 130. An error in a user's associator keeps its traceback."""
    try:
        return command()
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in ("", "slam_gym", "agents"):
            raise
        reason = f"{missing} is missing"
        if missing in _EXTRAS:  # not where a module of the user needs it
            reason += f": pip install 'slam_gym[{_EXTRAS[missing]}]'"
    except BrokenProcessPool:
        reason = "a worker process was killed, perhaps for want of memory: --resume goes on with what is left"
    except (ValueError, ImportError, OSError) as error:
        if hasattr(error, "__notes__"):  # it says whose function has failed
            raise
        reason = str(error)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        raise typer.Exit(130) from None
    print(f"error: {reason}", file=sys.stderr)
    raise typer.Exit(2)


def evaluate(
    evaluation: "Evaluation", execution: Execution, out: Path, films: Sequence[Callable[[], Path]] = ()
) -> None:
    """Carry out an evaluation, make its films, write its report and print its tables, with progress bars.

    If it is interrupted, prints how to resume it.
    """
    from rich.console import Console
    from rich.progress import track

    from agents.evaluation.pipeline import carry_out, run_all
    from agents.evaluation.tables import print_table

    try:
        carry_out(evaluation, out, execution.jobs, execution.resume)
        if films:
            list(track(run_all(films, execution.jobs), "films", total=len(films)))
    except KeyboardInterrupt:
        print(f"interrupted; go on with the same command and --resume --output {out}")
        raise
    from agents.reports.pages import write_report  # matplotlib takes a second to import

    for table in write_report(out, partial(track, description="report")).tables:
        print_table(table, Console())
    print(f"report: {out / 'report.html'}")
