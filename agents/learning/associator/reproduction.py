"""The training of the learned associator, from worlds to weights."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from agents.learning.associator.decisions import Decisions
from agents.learning.associator.sources import HIDDEN, LEVELS, LOGS, LOOPS, VIEWS, VIEWS_AND_SIZES, Source
from agents.learning.associator.training import Odds, TensorBatch, Training, batches_of, fit, mean_loss
from slam_gym.association.learned.associator import WEIGHTS
from slam_gym.association.learned.inputs import INPUTS, VERSION
from slam_gym.association.learned.network import load_network
from slam_gym.weights import Card, Weights, figure

HIDDEN_LOOPS = (
    *(("sizes", 6, name) for name in ("office", "drift-2", "hall", "crowd-drift")),
    *(("all but places", 7, name) for name in ("crowd", "drift-3", "aliased-drift", "loop")),
    *((VIEWS, 8, name) for name in ("office", "crowd", "drift-1", "drift-2", "aliased", "hall-drift", "sparse")),
    *((VIEWS_AND_SIZES, 9, name) for name in ("office", "drift-1", "drift-3", "hall", "sparse", "loop")),
)
"""Further runs: what is hidden, the world, and the scenario."""


@dataclass(frozen=True)
class Plan:
    """What is looked at, in train worlds, and how often the network is trained."""

    levels: Sequence[str] = LEVELS
    level_worlds: int = 16
    told: int = 12  # of them in which nothing is hidden; then sizes and more are, in turn
    loops: Sequence[str] = LOOPS
    loop_worlds: int = 6
    hidden: Sequence[tuple[str, int, str]] = HIDDEN_LOOPS
    logs: Sequence[str] = LOGS
    held_out: int = 4  # worlds of each level, after those trained on
    seeds: Sequence[int] = (0, 1)  # the one that is best on what is held out ships
    training: Training = field(default_factory=Training)


QUICK = Plan(
    levels=("clutter/2", "detection/2", "closure/3"), level_worlds=2, told=2, loops=(), hidden=(), logs=(),
    held_out=1, seeds=(0, 1), training=Training(epochs=6),
)  # fmt: skip


def sources(plan: Plan) -> tuple[list[Source], list[Source]]:
    """What is trained on, and what is held out."""
    first, last = plan.level_worlds, plan.level_worlds + plan.held_out
    hidden = [HIDDEN[0] if k < plan.told else HIDDEN[k % len(HIDDEN)] for k in range(last)]
    train = [Source("level", name, k, hidden=hidden[k]) for k in range(first) for name in plan.levels]
    train += [Source("loop", name, k) for k in range(plan.loop_worlds) for name in plan.loops]
    train += [Source("loop", name, k, hidden=hidden) for hidden, k, name in plan.hidden]
    for k, associator in enumerate(("map_hypothesis", "marginal")):  # whose maps go wrong in other ways
        train += [Source("log", name, k, associator) for name in plan.logs]
    return train, [Source("level", name, k, hidden=hidden[k]) for k in range(first, last) for name in plan.levels]


SHARES = {"level": 0.5, "loop": 0.45, "log": 0.05}
"""What each kind of source counts in all, however many scans it has."""

_HIDDEN_COUNT = 4.0


def look(found: Sequence[Source], say: Callable[[str], None]) -> list[Decisions]:
    """The decisions of all sources, in their order, weighed by kind."""
    kinds: dict[str, list[Decisions]] = {}
    for source in found:
        began = time.perf_counter()
        own = list(source.scans())
        say(f"{source.name}, world {source.world}: {len(own)} scans in {time.perf_counter() - began:.1f} s")
        kinds.setdefault(source.kind, []).extend(counted(source, own))
    return weighed(kinds)


def counted(source: Source, scans: Sequence[Decisions]) -> list[Decisions]:
    """Its scans, of more weight where something is hidden: there are few of those, and many a user has no more."""
    return [d._replace(weight=d.weight * (_HIDDEN_COUNT if source.hidden != HIDDEN[0] else 1.0)) for d in scans]


def weighed(kinds: Mapping[str, Sequence[Decisions]]) -> list[Decisions]:
    """All scans, each kind of source with its share of the weight; the mean weight is 1."""
    count, scans = sum(map(len, kinds.values())), []
    shared = sum(SHARES[kind] for kind in kinds)
    for kind, own in kinds.items():
        factor = SHARES[kind] / shared * count / max(sum(d.weight for d in own), 1e-9)
        scans += [d._replace(weight=d.weight * factor) for d in own]
    return scans


def reproduce(quick: bool, command: str, say: Callable[[str], None]) -> Weights:
    """The weights of the best seed on what is held out; the figures of the card are those of all seeds.

    Raises ValueError where `SLAM_GYM_DATA` does not say where the recordings are, unless it is a quick one.
    """
    plan = QUICK if quick else Plan()
    if plan.logs and not os.environ.get("SLAM_GYM_DATA"):
        raise ValueError("SLAM_GYM_DATA is not set: the training looks at Victoria Park and MR.CLAM as well")
    train, held_out = sources(plan)
    return trained(plan, look(train, say), look(held_out, say), command, say)


def trained(
    plan: Plan, train: list[Decisions], held_out: list[Decisions], command: str, say: Callable[[str], None]
) -> Weights:
    """Weights and card, from the scans."""
    fits = []
    for seed in plan.seeds:
        network, losses = fit(train, held_out, replace(plan.training, seed=seed))
        say(f"seed {seed}: cross-entropy held out, by epoch: {' '.join(f'{loss:.4f}' for loss in losses.curve)}")
        say(f"seed {seed}: cross-entropy {losses.held_out:.4f} held out, {losses.model:.4f} by the model alone")
        fits.append((network, losses))
    metrics = {
        "cross-entropy held out": figure([losses.held_out for _, losses in fits]),
        "cross-entropy trained on": figure([losses.train for _, losses in fits]),
        "cross-entropy held out, the model alone": figure([losses.model for _, losses in fits]),
        "scans": figure([float(len(train))]),
    } | _of_shipped(batches_of(held_out, plan.training.batch))
    names = (*plan.levels, *plan.loops, *(f"recording:{name}" for name in plan.logs))
    card = Card(VERSION, INPUTS, {}, tuple(names), tuple(plan.seeds), command, metrics)
    best = min(range(len(fits)), key=lambda k: fits[k][1].held_out)
    return Weights(card, fits[best][0].arrays())


def _of_shipped(held_out: list[TensorBatch]) -> dict[str, dict[str, float]]:
    """What the weights that ship come to on the same scans; nothing where they were made for other inputs."""
    try:
        network = load_network(WEIGHTS, VERSION, INPUTS)
    except ValueError:
        return {}
    return {"cross-entropy held out, the weights that ship": figure([mean_loss(Odds.of(network), held_out)])}
