"""`slam-gym evaluate-association` runs each associator in the loop on the same test worlds; `--suite` evaluates them on
the same scans, with one number per capability; `--recording` runs them over a real log. All write a report.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Literal

from typer import Option

from agents.cli import command, evaluate
from agents.options import Associators, Episodes, Execution, Names, Recorded, Scenes, Suite, search_of

LOOPS = ("office-small", "hall", "crowd")
EPISODES = 30


@dataclass(frozen=True)
class Loop(Scenes, Episodes):
    """Drives through scenarios."""

    driver: Annotated[str, Option(metavar="NAME", help="See slam-gym list drivers.")] = "information_gain"


def main(
    execution: Execution,
    loop: Loop,
    suite_options: Suite,
    recorded: Recorded,
    associators: Associators = None,
    relocation: Annotated[
        Names,
        Option(
            metavar="NAME …",
            help="See slam-gym list relocators; or none, without --suite. By default none and gcbb; "
            "--recording: gcbb; --suite: all.",
        ),
    ] = None,
    split: Annotated[
        Literal["train", "test"] | None, Option(help="Split of the worlds, by default test; tune on train.")
    ] = None,
    suite: Annotated[bool, Option("--suite", help="One number per capability instead of drives.")] = False,
    recording: Annotated[
        str | None, Option(metavar="LOG", help="See slam-gym list recordings; or .csv, .npz, .g2o, .txt (iSAM).")
    ] = None,
    film: Annotated[bool, Option("--film", help="Film the first drive of two to four, two by two.")] = False,
) -> None:
    """Evaluate associators in the same test worlds, on the scans of the suite, or on a recording."""
    from agents.evaluation.associators import SHIPPED

    if suite and recording:
        raise ValueError("--suite and --recording are two evaluations: give one of them")
    if recording and split:
        raise ValueError("--split: a recording has no worlds")
    split = split or "test"
    if film and (suite or recording or not 2 <= len(associators or ()) <= 4):
        raise ValueError("--film shows drives of two to four associators: name them by --associators")
    kind = "suite" if suite else "recording" if recording else "association"
    _check_options_apply(kind, {"association": loop, "suite": suite_options, "recording": recorded})
    names, out, films = associators or SHIPPED, execution.folder(kind), list[Callable[[], Path]]()
    if suite:
        from agents.suite import suite_evaluation
        from slam_gym.association import RELOCATORS
        from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION

        chosen = set(suite_options.experiments or EXPERIMENTS)
        if relocation and RELOCATION not in chosen:
            raise ValueError(f"--relocation is about the experiment {RELOCATION}, which was not asked for")
        if associators and chosen == {RELOCATION}:
            raise ValueError(f"--associators: the experiment {RELOCATION} is about relocators")
        evaluation = suite_evaluation(suite_options, names, relocation or list(RELOCATORS), split)
    elif recording:
        from agents.evaluation.mapped_log import logs_of, recording_evaluation

        logs = logs_of(recorded, recording)
        for log in logs:
            print(f"{log.name}: {log.source} {log.terms}")
        conditions = {"recording": recording, "every": recorded.every, "reference": recorded.reference}
        evaluation = recording_evaluation(names, logs, conditions, out, _searches(relocation or [None]))
    else:
        from agents.evaluation.episodes import Driver, associator_evaluation

        loops, searches = loop.loops(LOOPS, split), _searches(relocation or ["none", None])
        evaluation = associator_evaluation(names, loops, loop.driver, loop.range(EPISODES, split), searches, out)
        if film:
            from agents.reports.film import films_of  # imports ffmpeg and pygame, which only films need

            filmed = replace(loops[0], relocation=searches[-1])
            films = films_of([Driver(loop.driver)], filmed, loop.seed, out, names)
    evaluate(evaluation, execution, out, films)


def _searches(names: Sequence[str | None]) -> list[str | None]:
    """The relocation searches, each once, as `search_of` reads them."""
    return [search_of(name) for name in dict.fromkeys(names)]


def _check_options_apply(kind: str, groups: dict[str, Loop | Suite | Recorded]) -> None:
    """Raise ValueError for an option that would be ignored, such as `--experiments` without `--suite`."""
    for other, options in groups.items():
        for field in fields(options) if other != kind else ():
            if getattr(options, field.name) != field.default:
                option = {"overrides": "set"}.get(field.name, field.name).replace("_", "-")
                meant = "is about drives through scenarios" if other == "association" else f"belongs to --{other}"
                instead = ", which was not asked for" if kind == "association" else f", not to --{kind}"
                raise ValueError(f"--{option} {meant}{instead}")


app = command("evaluate-association", main, "--scenario drift-2 --associators jcbb learned --episodes 4")

if __name__ == "__main__":
    app()
