"""`slam-gym evaluate`: evaluates drivers on the same test worlds, with a report and films."""

from pathlib import Path
from typing import Annotated

from typer import Option

from agents.cli import command, evaluate
from agents.options import Episodes, Execution, ExploreWorld, Names

EPISODES = 4  # for a first look in a minute; tables need 40


def main(
    world: ExploreWorld,
    episodes: Episodes,
    execution: Execution,
    agents: Annotated[Names, Option(metavar="NAME …", help="See slam-gym list drivers; or module:Class.")] = None,
    model: Annotated[
        list[Path] | None, Option(help="File of a learned agent; several, as training seeds, are pooled.")
    ] = None,
    trust: Annotated[bool, Option("--trust", help="Allow model files that can run code when read.")] = False,
    films: Annotated[bool, Option("--films/--no-films", help="Film the first episode of each agent.")] = True,
) -> None:
    """Evaluate drivers on the same test worlds."""
    from agents.drivers.base import SHOWN
    from agents.evaluation.episodes import driver_evaluation, drivers_of

    loops, numbers = world.loops(["office"], split="test"), episodes.range(EPISODES)
    out = execution.folder(loops[0].world.split(".")[0])
    drivers, filmed = drivers_of(agents or SHOWN, model or [], trust), []
    evaluation = driver_evaluation(drivers, loops, numbers)
    if films:
        from agents.reports.film import films_of  # imports ffmpeg and pygame, which only films need

        filmed = films_of(drivers, loops[0], episodes.seed, out)
    evaluate(evaluation, execution, out, filmed)
    if not episodes.episodes:
        print(f"next: --episodes 40 for intervals that tell drivers apart; open {out / 'report.html'}")


app = command("evaluate", main, "--scenario office drift-2 --agents nearest_frontier learned --episodes 10")

if __name__ == "__main__":
    app()
