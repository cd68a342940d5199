"""The training of the learned driver, from worlds to weights."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from agents.drivers.goal_network import Size
from agents.drivers.goal_tokens import TOKEN_FIELDS
from agents.drivers.learned import SIZE, VERSION
from agents.evaluation.parallel import run_all
from agents.learning.driver.examples import Drive, Examples, together
from agents.learning.driver.network import GoalNetwork
from agents.learning.driver.training import Training, fit, regrets
from agents.reproduce import figure
from slam_gym.types import Array
from slam_gym.weights import Card, Weights

SCENARIOS = (
    "office",
    "aliased",
    "hall",
    "office",
    "aliased",
    "crowd",
)  # the buildings: where features are, wheels do not tell
FIRST_WORLD, HELD_OUT = 40_000, 5  # of the train split; every fifth is held out


@dataclass(frozen=True)
class Plan:
    """How many episodes are driven, a scenario after the other, and how often networks are trained on them."""

    scenarios: Sequence[str] = SCENARIOS
    episodes: Sequence[int] = (2_000,)  # driven on by information gain; from the second number on by the learner
    seeds: Sequence[int] = (0, 1, 2)  # the networks of the first `size.members` ship
    size: Size = SIZE
    training: Training = field(default_factory=lambda: Training(epochs=15))
    jobs: int = field(default_factory=joblib.cpu_count)


QUICK = Plan(scenarios=("office-small", "hall"), episodes=(6, 2), seeds=(0, 1, 2), training=Training(epochs=4), jobs=1)


def reproduce(quick: bool, command: str, say: Callable[[str], None]) -> Weights:
    """Weights of the first networks; the figures of the card are those of all seeds."""
    plan = QUICK if quick else Plan()
    rounds: list[tuple[int, Examples]] = []
    found, first = None, FIRST_WORLD
    for count in plan.episodes:
        rounds += drive(plan, range(first, first + count), found, say)
        first, found = first + count, trained(plan, rounds, command, say)
    assert found is not None
    return found


def drive(
    plan: Plan, worlds: Sequence[int], weights: Weights | None, say: Callable[[str], None]
) -> list[tuple[int, Examples]]:
    """(world, its states) of each of the worlds."""
    began = time.perf_counter()
    drives = [Drive(plan.scenarios[world % len(plan.scenarios)], world, weights) for world in worlds]
    found = sorted(run_all([_Numbered(d) for d in drives], plan.jobs), key=lambda pair: pair[0])
    say(f"{len(found)} drives, {sum(len(e) for _, e in found)} states, {time.perf_counter() - began:.0f} s")
    return found


@dataclass(frozen=True)
class _Numbered:
    drive: Drive

    def __call__(self) -> tuple[int, Examples]:
        return self.drive.world, self.drive.run()


def trained(plan: Plan, rounds: Sequence[tuple[int, Examples]], command: str, say: Callable[[str], None]) -> Weights:
    """Weights and card, from the states."""
    held_out = together(examples for world, examples in rounds if _is_held_out(world))
    train = together(examples for world, examples in rounds if not _is_held_out(world))
    networks = [fitted(plan, seed, train, held_out, say) for seed in plan.seeds]
    regret = [regrets([network], held_out).learned for network in networks]
    shipped = networks[: plan.size.members]
    mean, own = regrets(shipped, held_out), regrets(shipped, train)
    say(f"mean of {len(shipped)}: {mean.learned.mean():.3f}; the greedy driver: {mean.greedy.mean():.3f}")
    metrics = {
        "regret held out, of one network [.01 E]": _figure(regret),
        "regret held out [.01 E]": _figure([mean.learned]),
        "regret trained on [.01 E]": _figure([own.learned]),
        "regret held out, of the greedy driver [.01 E]": _figure([mean.greedy]),
        "states": figure([float(len(train) + len(held_out))]),
    }
    card = Card(VERSION, TOKEN_FIELDS, {}, tuple(dict.fromkeys(plan.scenarios)), tuple(plan.seeds), command, metrics)
    return Weights(card, stacked(shipped))


def fitted(plan: Plan, seed: int, train: Examples, held_out: Examples, say: Callable[[str], None]) -> GoalNetwork:
    """One network; says what a choice loses on held-out worlds after each epoch."""
    curve: list[float] = []

    def judge(network: GoalNetwork) -> None:
        curve.append(float(regrets([network], held_out).learned.mean()))

    network = fit(train, plan.size, replace(plan.training, seed=seed), judge)
    say(f"seed {seed}: a choice loses, hundredths of E held out, by epoch: {' '.join(f'{x:.3f}' for x in curve)}")
    return network


def _figure(regrets_of_seeds: Sequence[Array]) -> dict[str, float]:
    """As `figure`, of means over states, and no narrower than what other states of the same kind would give."""
    found = figure([float(own.mean()) for own in regrets_of_seeds])
    error = 3.0 * float(np.mean([own.std() / len(own) ** 0.5 for own in regrets_of_seeds]))
    low, high = found["estimate"] - error, found["estimate"] + error
    return found | {"low": max(0.0, min(found["low"], low)), "high": max(found["high"], high)}


def stacked(networks: Sequence[GoalNetwork]) -> dict[str, NDArray[Any]]:
    """The arrays of all members, one before the other."""
    arrays = [network.arrays() for network in networks]
    return {name: np.stack([own[name] for own in arrays]) for name in arrays[0]}


def _is_held_out(world: int) -> bool:
    return world % HELD_OUT == 0
