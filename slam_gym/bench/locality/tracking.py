"""What covisibility locality saves JCBB while tracking, and what, if anything, it loses.

The same exploration (nearest frontier, planned over the estimate) with JCBB told of covisibility localities and
without, on the same test worlds. Pairing tests are those for individual compatibility; nodes and joint tests are the
search's. Times are those of the associator's calls alone. The linear bound of relocation is another matter: here a
prior on the pose has already gated the candidates, so the saving is in pairing tests, and grows with what is in reach.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np

import slam_gym  # noqa: F401  (registers the environments)
from slam_gym.association import jcbb
from slam_gym.bench.speed.step import Pilot
from slam_gym.scenarios import get_scenario
from slam_gym.types import Hypothesis, Prediction, Scan

SCENARIOS = ("office", "aliased", "hall", "crowd")


@dataclass(eq=False)
class Effort:
    """What the associator spent over a run."""

    calls: int = 0
    seconds: float = 0.0
    pairing_tests: int = 0
    nodes: int = 0
    joint_tests: int = 0
    limits: int = 0

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        start = time.perf_counter()
        hypothesis = jcbb(scan, prediction)
        self.seconds += time.perf_counter() - start
        self.calls += 1
        self.pairing_tests += hypothesis.effort.individual_tests
        self.nodes += hypothesis.effort.nodes
        self.joint_tests += hypothesis.effort.joint_tests
        self.limits += hypothesis.effort.limit_hit
        return hypothesis


def run(scenario: str, locality: str | None, episodes: int, budget: int | None) -> dict[str, float]:
    """Effort a scan and quality of the map, means over the episodes."""
    effort, rows = Effort(), []
    settings = get_scenario(scenario)
    if budget:
        settings = replace(settings, budget=budget)
    env: Any = gym.make(
        "slam_gym/Explore-v0", scenario=settings, split="test", action="twist", associator=effort, locality=locality
    ).unwrapped
    for number in range(episodes):
        env.reset(seed=number, options={"world": number})
        pilot, over, step = Pilot(number), False, 0
        while not over:
            _, _, over, _, info = env.step(pilot.action(env, step))
            step += 1
        rows.append(info["map_quality"])
    return {
        "tests": effort.pairing_tests / effort.calls,
        "nodes": effort.nodes / effort.calls,
        "joint": effort.joint_tests / effort.calls,
        "us": 1e6 * effort.seconds / effort.calls,
        "limits": effort.limits,
        **{
            name: float(np.mean([row[name] for row in rows]))
            for name in ("precision", "recall", "map_error", "duplicates")
        },
    }


def main(argv: list[str] | None = None) -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(prog="python -m slam_gym.bench locality --tracking", description=__doc__)
    parser.add_argument("--episodes", type=int, default=6, help="test worlds 0 … N−1 a scenario (default 6)")
    parser.add_argument("--budget", type=int, help="[ticks] an episode lasts, instead of the scenario's")
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS)
    arguments = parser.parse_args(argv)
    print(
        "scenario  locality       pairing tests   nodes  joint tests  µs a scan   precision  recall  map error  dupl."
    )
    for scenario in arguments.scenarios:
        for locality in ("covisibility", None):
            row = run(scenario, locality, arguments.episodes, arguments.budget)
            print(
                f"{scenario:9s} {locality or 'everything':12s}   {row['tests']:12.1f}  {row['nodes']:6.1f} "
                f"{row['joint']:12.1f}  {row['us']:9.1f}   {row['precision']:9.4f} {row['recall']:7.4f}  "
                f"{row['map_error']:9.3f}  {row['duplicates']:5.2f}" + ("  node limit hit" if row["limits"] else "")
            )
