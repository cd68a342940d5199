"""`slam-gym play`: drive the robot yourself and watch its map grow, or watch an agent: `--agent NAME`."""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from typer import Option

from agents.cli import command
from agents.options import ExploreWorld
from slam_gym.types import UNPAIRED, Effort, Hypothesis, Landmarks, Locality, Relocation, Scan

if TYPE_CHECKING:
    from agents.drivers.base import ActionKind, Agent, Info, Observation
    from agents.evaluation.episodes import ExploreArguments
    from slam_gym.association.prediction import Prediction

HELP = """\
  ↑ ↓ or W S   forward, backward        N   next world
  ← → or A D   turn                     R   this world again
  C            another associator, from the next scan on
  L            relocation on or off
  Esc          quit

You see the truth in the background. The robot knows only what it has drawn over it: the floor that its range finder
has swept, and features with their ellipses of uncertainty. Drive where it has not been, to map more; come back to
where it has been, to make the ellipses shrink. At the end your map error is compared with that of information gain."""
KEYS = "C associator   L relocation   R again   N next world   Esc quit"
RIVAL = "information_gain"

WISHES = {"quit": "K_ESCAPE", "next": "K_n", "again": "K_r", "associator": "K_c", "relocation": "K_l"}
"""The requests of the player, and their keys by pygame's names."""


class Controls:
    """The player's controls: the keys that are down, and requests."""

    name = "you"
    action: ActionKind = "twist"

    def __init__(self) -> None:
        import pygame  # extra `render`; the window of the environment delivers the keys

        self._pygame = pygame
        directions = {(1, 0): ("UP", "w"), (-1, 0): ("DOWN", "s"), (0, 1): ("LEFT", "a"), (0, -1): ("RIGHT", "d")}
        self._keys = {getattr(pygame, f"K_{key}"): way for way, keys in directions.items() for key in keys}
        self._wishes = {getattr(pygame, key): wish for wish, key in WISHES.items()}
        self.reset(0)

    def reset(self, seed: int) -> None:
        self._down: set[int] = set()

    def act(self, observation: Observation, info: Info) -> NDArray[np.float32]:
        ways = {self._keys[key] for key in self._down & self._keys.keys()}
        return np.sum([(0.0, 0.0), *ways], axis=0).astype(np.float32)

    def poll(self) -> str | None:
        """Process the events since the last call; returns one of `WISHES` where the player asked for it."""
        pygame, wish = self._pygame, None
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                return "quit"
            if event.type == pygame.KEYDOWN:
                self._down.add(event.key)
                wish = self._wishes.get(event.key, wish)
            elif event.type == pygame.KEYUP:
                self._down.discard(event.key)
        return wish


@dataclass
class Game:
    """The settings of a game, including those that the player can switch while it runs."""

    arguments: ExploreArguments
    agent: Agent
    controls: Controls
    associators: deque[str]  # the first is in use; empty for true association, which cannot be switched
    relocating: bool
    rivals: dict[int, float] = field(default_factory=dict)  # world → map error of information gain

    def make(self) -> gym.Env[Any, Any]:
        """The environment with its window, in which the player selects the associator, and switches relocation."""
        switched = {"associator": self.associate} if self.associators else {}
        return self.arguments.make(self.agent.action, render_mode="human", relocation=self.relocate, **switched)

    def associate(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        from slam_gym.association import resolve_associator

        return resolve_associator(self.associators[0])(scan, prediction)

    def relocate(self, scan: Scan, landmarks: Landmarks, locality: Locality | None) -> Relocation:
        """The result of the relocation search, or no pose while relocation is off."""
        from slam_gym.association import resolve_relocator
        from slam_gym.slam.relocate import SEARCH

        if self.relocating:
            return resolve_relocator(self.arguments.relocation or SEARCH)(scan, landmarks, locality)
        unpaired = np.full(len(scan), UNPAIRED)
        return Relocation(unpaired, np.full(3, np.nan), np.full((3, 3), np.nan), 0.0, 0, 1, False, 0, Effort())

    def verdict(self, world: int, info: Info) -> str:
        """The end of a world, beside that of information gain with the associator with which the game began."""
        from agents.drivers.base import make_agent
        from agents.evaluation.episodes import run_episode

        if world not in self.rivals:
            driver = make_agent(RIVAL)
            env = self.arguments.make(driver.action)
            self.rivals[world] = float(run_episode(env, driver, world)["map_error"])
            env.close()
        quality, rival = info["map_quality"], self.rivals[world]
        own = float(quality["map_error"])
        player = self.agent.name
        who = f"{player} beat it" if own < rival else f"it beat {player}" if own > rival else "a draw"
        return (
            f"world {world}: map error {own:.3f} (0 is perfect), coverage {quality['coverage']:.0%}, "
            f"{quality['precision']:.1%} of the pairings right; information gain {rival:.3f}: {who}"
        )

    @property
    def keys(self) -> str:
        """The keys that have an effect."""
        return f"arrows or WASD drive   {KEYS}" if self.agent is self.controls else KEYS

    def state(self) -> str:
        """What the player has chosen."""
        associator = self.associators[0] if self.associators else "true_association"
        return f"{associator}, relocation {'on' if self.relocating else 'off'}"


def play(game: Game, env: gym.Env[Any, Any], world: int, steps: int | None = None) -> str:
    """Play one world; returns the request that ended it. After the last tick, the picture stays until a request."""
    import pygame

    from agents.drivers.base import visible
    from agents.evaluation.episodes import begin_episode

    observation, info = begin_episode(env, game.agent, world)
    if pygame.display.get_driver() in ("dummy", "offscreen"):
        print("there is no display here, so there is no window to see and no key to press (Ctrl-C ends it)")
    verdict = ""
    for count in itertools.count():
        pygame.display.set_caption(verdict or f"{game.state()}   ({game.keys})")
        if count == steps:
            return "quit"
        wish = game.controls.poll()
        if wish == "associator":
            game.associators.rotate(-1)
        elif wish == "relocation":
            game.relocating = not game.relocating
        elif wish is not None:
            return wish
        if verdict:
            env.render()  # at the frame rate
            continue
        observation, _, ended, _, info = env.step(game.agent.act(observation, visible(info)))
        if ended:
            verdict = game.verdict(world, info)
            print(verdict)


def main(
    world_options: ExploreWorld,
    agent: Annotated[
        str | None, Option(metavar="NAME", help="Watch a driver: see slam-gym list drivers; or module:Class.")
    ] = None,
    model: Annotated[Path | None, Option(metavar="FILE", help="Model of a learned agent.")] = None,
    seed: Annotated[int, Option(min=0, metavar="K", help="World k of the train split, with seed k.")] = 0,
    steps: Annotated[int | None, Option(min=1, metavar="N", help="Stop after so many steps.")] = None,
) -> None:
    """Drive the robot, or watch an agent drive."""
    from agents.drivers.base import make_agent
    from agents.evaluation.associators import SIMPLEST_FIRST
    from slam_gym.simulation.judged import CEILING

    watched = make_agent(agent or "ppo", model) if agent or model else None
    arguments, controls = world_options.arguments("office", split="train"), Controls()
    probe: Any = arguments.make("twist").unwrapped  # raises for unknown names; contains the scenario's associator
    names = () if probe.associator == CEILING else dict.fromkeys([probe.associator, *SIMPLEST_FIRST])
    game = Game(arguments, watched or controls, controls, deque(names), arguments.relocation is not None)
    env = game.make()
    print(HELP if watched is None else f"watching {watched.name}: {game.keys}")
    wish, world = "again", seed
    try:
        while wish != "quit":
            world += wish == "next"
            wish = play(game, env, world, steps)
    finally:
        env.close()


app = command("play", main, "--scenario office-small --associator jcbb")

if __name__ == "__main__":
    app()
