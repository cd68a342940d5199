"""`slam-gym play`: drive the robot yourself and watch its map grow, or watch an agent: `--agent NAME`."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from agents.cli import command
from agents.options import World


def main(
    world_options: World,
    agent: Annotated[
        str | None, Option(metavar="NAME", help="Watch a driver: see slam-gym list drivers; or module:Class.")
    ] = None,
    model: Annotated[Path | None, Option(metavar="FILE", help="Model of a learned agent.")] = None,
    seed: Annotated[int, Option(min=0, metavar="K", help="World k of the train split, with seed k.")] = 0,
    steps: Annotated[int | None, Option(metavar="N", help="Stop after so many steps.")] = None,
) -> None:
    """Drive the robot, or watch an agent drive."""
    from agents.drivers.base import make_agent
    from agents.evaluation.associators import SIMPLEST_FIRST
    from agents.game import HELP, KEYS, Controls, Game, Screen, play
    from slam_gym.simulation.judged import CEILING

    watched = make_agent(agent, model) if agent else None
    arguments, controls = world_options.arguments("office", split="train"), Controls()
    probe: Any = arguments.make("twist").unwrapped  # raises for unknown names; contains the scenario's associator
    names = () if probe.associator == CEILING else dict.fromkeys([probe.associator, *SIMPLEST_FIRST])
    game = Game(arguments, watched or controls, controls, deque(names), arguments.relocation is not None)
    env, screen = game.make(), Screen(float(probe.metadata["render_fps"]))
    print(HELP if watched is None else f"watching {watched.name}: {KEYS}")
    wish, world = "again", seed
    try:
        while wish != "quit":
            world += wish == "next"
            wish = play(game, env, screen, world, steps)
    finally:
        env.close()
        screen.window.close()


app = command(main, "slam-gym play --scenario office-small --associator jcbb")
if __name__ == "__main__":
    app()
