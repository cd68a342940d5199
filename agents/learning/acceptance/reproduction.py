"""The training of the learned acceptance, from worlds to weights."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from agents.learning.acceptance.answers import Asked, asked
from agents.learning.acceptance.training import Outcome, accepted_by, by_rule, fit, outcome
from slam_gym.association.learned.acceptance import COST, INPUTS, VERSION
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION
from slam_gym.types import BoolArray
from slam_gym.weights import Card, Weights

LEVELS = tuple(level.id for level in EXPERIMENTS[RELOCATION].levels)
ALSO = ("aliasing/1", "aliasing/3", "detection/2", "detection/3")  # in every third world: identical rooms, poor sight


@dataclass(frozen=True)
class Plan:
    """Which train worlds are asked, and how much of them."""

    levels: Sequence[str] = LEVELS
    also: Sequence[str] = ALSO
    worlds: int = 12
    problems: int = 24  # a world
    folds: int = 4  # every world is judged by a network that has not seen it


QUICK = Plan(levels=("kidnapped/0", "kidnapped/3"), also=(), worlds=3, problems=16, folds=3)


def sources(plan: Plan) -> list[tuple[str, int]]:
    """Levels and worlds."""
    return [
        (level, k) for k in range(plan.worlds) for level in (*plan.levels, *(plan.also if k % 3 == 0 else ()))
    ]  # fmt: skip


def reproduce(quick: bool, command: str, say: Callable[[str], None]) -> Weights:
    """The weights, from all worlds; the figures of the card are those of worlds held out in turn."""
    plan, found = QUICK if quick else Plan(), {}
    for level, world in sources(plan):
        began = time.perf_counter()
        found[level, world] = asked(level, world, plan.problems)
        say(f"{level}, world {world}: {len(found[level, world].answers)} answers, {time.perf_counter() - began:.1f} s")
    return trained(plan, found, command, say)


def trained(plan: Plan, found: dict[tuple[str, int], Asked], command: str, say: Callable[[str], None]) -> Weights:
    """Weights and card, from the answers."""
    rule, own = by_rule(list(found.values())), held_out(plan, found)
    say(f"by the rule, inside right {rule.recall:.3f}, wrong {rule.wrong:.3f}, invented {rule.invented:.4f}")
    say(f"learned: {own.recall:.3f}, {own.wrong:.3f}, {own.invented:.4f}")
    inside, outside = sum(a.inside for a in found.values()), sum(a.outside for a in found.values())
    metrics = {
        "inside, right": _rate(own.recall, inside), "inside, wrong": _rate(own.wrong, inside),
        "invented": _rate(own.invented, outside), "inside, right, by the rule": _rate(rule.recall, inside),
        "inside, wrong, by the rule": _rate(rule.wrong, inside), "invented, by the rule": _rate(rule.invented, outside),
    }  # fmt: skip
    arrays = fit([answer for one in found.values() for answer in one.answers])
    card = Card(VERSION, INPUTS, {}, (*plan.levels, *plan.also), (0,), command, metrics)
    return Weights(card, arrays)


def held_out(plan: Plan, found: dict[tuple[str, int], Asked]) -> Outcome:
    """What the network comes to on worlds that it was not trained on, each fold of them in turn."""
    judged: list[Asked] = []
    accepted: list[BoolArray] = []
    for fold in range(plan.folds):
        seen = [a for (_, world), one in found.items() if world % plan.folds != fold for a in one.answers]
        others = [one for (_, world), one in found.items() if world % plan.folds == fold]
        accepted += accepted_by(fit(seen), others, COST)
        judged += others
    return outcome(judged, accepted)


def _rate(value: float, count: int) -> dict[str, float]:
    """With three standard deviations of a rate of so many."""
    sigma = float(np.sqrt(max(value * (1.0 - value), 1.0 / max(count, 1)) / max(count, 1)))
    return {"estimate": value, "low": value - 3.0 * sigma, "high": value + 3.0 * sigma}
