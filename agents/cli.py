"""Shared code of the commands: typer commands whose groups of options are dataclasses, and running an evaluation."""

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from agents.options import Execution
from slam_gym.__main__ import ended

if TYPE_CHECKING:
    from agents.evaluation.pipeline import Evaluation


def command(
    function: Callable[..., int | None], example: str, name: str | None = None, app: typer.Typer | None = None
) -> typer.Typer:
    """The typer app of a function, as in `app = command(main, "slam-gym …")`, with an example at the end of its help.

    With `name` and `app`, the function becomes one of several commands of that app. A parameter that is a dataclass,
    such as `ExploreWorld`, is replaced by options for its fields. An option with several values takes them in a row,
    as in `--agents random learned`. Invalid input ends with one line of text and exit code 2.
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
    app = app or typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command(name, help=function.__doc__, epilog=f"Example: {example}", cls=_SeveralValues)(call)
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
        results = carry_out(evaluation, out, execution)
        if films:
            list(track(run_all(films, execution.jobs), "films", total=len(films)))
    except KeyboardInterrupt:
        print(f"interrupted; go on with the same command and --resume --output {out}")
        raise
    from agents.reports.pages import page_of, write_report  # matplotlib takes a second to import

    report = write_report(out, partial(track, description="report"))
    for table in page_of(results, out).tables:
        print_table(table, Console())
    print(f"report: {report}")
