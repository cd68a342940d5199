"""Drive the robot yourself and watch its map grow: `python -m agents.play`. Or watch an agent: `--agent NAME`."""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from agents.cli import add_explore_options, explore_arguments, program, run_main
from agents.drivers.base import AGENTS, ActionKind, Agent, Info, Observation, make_agent, visible
from agents.evaluation.episodes import agent_seed, reset_arguments

HELP = """\
  ↑ ↓ or W S   forward, backward        N   next world
  ← → or A D   turn                     R   this world again
  Esc          quit

You see the truth in the background. The robot knows only what it has drawn over it: the floor that its range finder
has swept, and features with their ellipses of uncertainty. Drive where it has not been, to map more; come back to
where it has been, to make the ellipses shrink."""


class Keyboard:
    """The human's hands: which keys are down, and what they ask for."""

    name = "you"
    action: ActionKind = "twist"

    def __init__(self) -> None:
        import pygame  # extra `render`; the environment's window delivers the keys

        self._pygame = pygame
        self._keys = {
            "forward": (pygame.K_UP, pygame.K_w), "backward": (pygame.K_DOWN, pygame.K_s),
            "left": (pygame.K_LEFT, pygame.K_a), "right": (pygame.K_RIGHT, pygame.K_d),
        }  # fmt: skip
        self._down: set[int] = set()

    def reset(self, seed: int) -> None:
        self._down.clear()

    def act(self, observation: Observation, info: Info) -> NDArray[np.float32]:
        held = {name: bool(self._down.intersection(keys)) for name, keys in self._keys.items()}
        forward, turn = held["forward"] - held["backward"], held["left"] - held["right"]
        return np.array([forward, turn], np.float32)

    def has_window(self) -> bool:
        """Whether there is a display for the environment's window to appear on."""
        return self._pygame.display.get_driver() not in ("dummy", "offscreen")

    def poll(self) -> str | None:
        """Take in what happened at the keyboard; "quit", "next" or "again" where that was asked for."""
        pygame = self._pygame
        asked = {pygame.K_ESCAPE: "quit", pygame.K_n: "next", pygame.K_r: "again"}
        wish = None
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                return "quit"
            if event.type == pygame.KEYDOWN:
                self._down.add(event.key)
                wish = asked.get(event.key, wish)
            elif event.type == pygame.KEYUP:
                self._down.discard(event.key)
        return wish


def play(env: gym.Env[Any, Any], agent: Agent, keyboard: Keyboard, world: int, steps: int | None = None) -> str:
    """One world; the wish that ended it. At the end of the budget the picture stays until a key tells what is next."""
    observation, info = env.reset(**reset_arguments(world))
    agent.reset(agent_seed(world))
    if not keyboard.has_window():
        print("there is no display here, so there is no window to see and no key to press (Ctrl-C ends it)")
    taken, ended = 0, False
    while steps is None or taken < steps:
        wish = keyboard.poll()
        if wish is not None:
            return wish
        if ended:
            env.render()
            continue
        observation, _, ended, _, info = env.step(agent.act(observation, visible(info)))
        taken += 1
        if ended:
            print(_verdict(world, info))
    return "quit"


def _verdict(world: int, info: Info) -> str:
    quality = info["map_quality"]
    return (
        f"world {world}: map error {quality['map_error']:.3f} (1 = empty map, 0 = perfect), coverage "
        f"{quality['coverage']:.0%}, {quality['precision']:.1%} of the pairings right; N next world, R again, Esc quits"
    )


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog=program("agents.play"), description="Drive the robot, or watch an agent drive.")
    p.add_argument("--agent", metavar="NAME", help=f"watch one of {', '.join(AGENTS)}, or module:Class")
    p.add_argument("--model", metavar="FILE", help="model of a learned agent")
    p.add_argument("--world", type=int, default=0, metavar="K", help="of the training worlds (default: %(default)s)")
    p.add_argument("--steps", type=int, metavar="N", help="stop after so many steps")
    add_explore_options(p, "office")
    return p


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    watched = make_agent(a.agent, a.model) if a.agent else None
    env = explore_arguments(a, split="train").make(watched.action if watched else "twist", render_mode="human")
    keyboard = Keyboard()
    print(HELP if watched is None else f"watching {watched.name}; N next world, R again, Esc quits")
    world, wish = a.world, "again"
    try:
        while wish != "quit":
            world += wish == "next"
            wish = play(env, watched or keyboard, keyboard, world, a.steps)
    finally:
        env.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
