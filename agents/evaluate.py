"""Evaluate agents on the same test worlds: `python -m agents.evaluate` compares those of `SHOWN` on `office`.

Writes into OUT: results.csv (one row per episode), results.json (what it depends on), report.html and films/.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from agents.cli import Episodes, World, command, evaluate
from agents.drivers.base import AGENTS, SHOWN
from agents.evaluation.drives import driver_evaluation, drivers_of, world_of
from agents.evaluation.pipeline import Execution

EPISODES = 4  # a first look in a minute; tables need 40


def main(
    world: World,
    episodes: Episodes,
    execution: Execution,
    agents: Annotated[list[str] | None, Option(help=f"Of {', '.join(AGENTS)}, or module:Class.")] = None,
    model: Annotated[list[Path] | None, Option(help="Of a learned agent; several are seeds of it, pooled.")] = None,
    trust: Annotated[bool, Option("--trust", help="Allow model files that can run code when read.")] = False,
    films: Annotated[bool, Option("--films/--no-films", help="Film the first episode of each agent.")] = True,
) -> None:
    """Evaluate agents on the same test worlds."""
    arguments, numbers = world.arguments("office", split="test"), episodes.range(EPISODES)
    out = execution.folder(world_of(arguments.plain).split(".")[0])
    drivers = drivers_of(agents or SHOWN, [str(file) for file in model or []], trust)

    def make_films() -> None:
        from agents.reports import film  # ffmpeg and pygame are needed for films only

        film.make_films(drivers, arguments, episodes.first, out, execution.jobs)

    evaluation = driver_evaluation(drivers, arguments, numbers)
    evaluate(evaluation, execution, out, make_films if films else None)
    if not episodes.episodes:
        print(f"next: --episodes 40 for intervals that tell drivers apart; open {out / 'report.html'}")


app = command(main)
if __name__ == "__main__":
    app()
