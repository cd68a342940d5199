"""Running the association suite, and its one number per capability."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from agents.evaluation.associators import Key, Task, find_associator
from agents.evaluation.results import Record, estimate
from agents.suite.problems import Course, ask, judge, problems
from agents.suite.relocation import kidnappings, outcome
from slam_gym.association import resolve_relocator
from slam_gym.metrics.statistics import Interval
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION, Experiment, get_level
from slam_gym.types import Array, Effort

OUTCOMES = ("correct", "silent", "wrong", "refused", "invented")


@dataclass(frozen=True)
class World:
    """One world of one level, and who is asked about it: associators, or relocators where it is about relocation."""

    setting: str  # id of the level
    episode: int  # number of the world
    asked: tuple[str, ...]
    problems: int
    split: str = "test"

    @property
    def keys(self) -> tuple[Key, ...]:
        return tuple((name, self.setting, self.episode) for name in self.asked)

    def without(self, done: set[Key]) -> Task | None:
        left = tuple(name for name, key in zip(self.asked, self.keys) if key not in done)
        return replace(self, asked=left) if left else None

    def run(self) -> list[Record]:
        level = get_level(self.setting)
        answer = self._relocate if level.experiment == RELOCATION else self._associate
        about = {"setting": self.setting, "episode": self.episode, "experiment": level.experiment, "knob": level.knob}
        return [{"associator": name} | about | record for name, record in answer().items()]

    def _associate(self) -> dict[str, Record]:
        level = get_level(self.setting)
        asked = {name: find_associator(name) for name in self.asked}
        judged: dict[str, list[Any]] = {name: [] for name in asked}
        efforts: dict[str, list[tuple[Effort, float]]] = {name: [] for name in asked}
        for problem in problems(Course(level, self.episode, self.split), self.problems):
            for name, associate in asked.items():
                start = time.perf_counter()
                hypothesis = ask(associate, problem)
                efforts[name].append((hypothesis.effort, time.perf_counter() - start))
                judged[name].append(judge(hypothesis.features, problem))
        return {name: _association(judged[name]) | _spent(efforts[name]) for name in asked}

    def _relocate(self) -> dict[str, Record]:
        asked = {name: resolve_relocator(name) for name in self.asked}
        outcomes: dict[str, Counter[str]] = {name: Counter() for name in asked}
        efforts: dict[str, list[tuple[Effort, float]]] = {name: [] for name in asked}
        for kidnapping in kidnappings(get_level(self.setting), self.episode, self.problems, self.split):
            for name, search in asked.items():
                start = time.perf_counter()
                found = search(kidnapping.scan, kidnapping.landmarks, kidnapping.locality)
                efforts[name].append((found.effort, time.perf_counter() - start))
                outcomes[name][outcome(found, kidnapping.pose)] += 1
        return {name: _relocation(outcomes[name]) | _spent(efforts[name]) for name in asked}


def _association(judged: Sequence[Any]) -> Record:
    """Shares over the problems of a world; NaN where it had none. The score is that of the scans, but not below 0."""
    mapped, paired = sum(j.mapped for j in judged), sum(j.right + j.wrong for j in judged)
    right = sum(j.right for j in judged)
    return {
        "problems": len(judged),
        "score": max(0.0, _mean(j.score for j in judged)) if judged else math.nan,
        "spoiled": _mean(j.wrong > 0 for j in judged),
        "refused": _mean(j.refused / j.mapped for j in judged),
        "exact": _mean(j.exact for j in judged),
        "precision": right / paired if paired else math.nan,
        "recall": right / mapped if mapped else math.nan,
    }


def _relocation(counts: Counter[str]) -> Record:
    """Outcomes, and their score: (correct − wrong, of those inside, not below 0) · (refused, of those outside)."""
    inside = counts["correct"] + counts["silent"] + counts["wrong"]
    outside = counts["refused"] + counts["invented"]
    known = inside > 0 and outside > 0
    gain = max(0, counts["correct"] - counts["wrong"]) / inside if known else math.nan
    return {
        "problems": inside + outside,
        "score": gain * counts["refused"] / outside if known else math.nan,
        **{name: counts[name] for name in OUTCOMES},
    }


def _spent(efforts: Sequence[tuple[Effort, float]]) -> Record:
    return {
        "nodes": _mean(effort.nodes for effort, _ in efforts),
        "microseconds": 1e6 * float(np.median([seconds for _, seconds in efforts])) if efforts else math.nan,
        "limits": sum(effort.limit_hit for effort, _ in efforts),
    }


def _mean(numbers: Iterable[float]) -> float:
    found = list(numbers)
    return float(np.mean(found)) if found else math.nan


def worlds(
    associators: Sequence[str], relocators: Sequence[str], experiments: Sequence[str], count: int, problems_each: int,
    split: str = "test", quick: bool = False,
) -> list[World]:  # fmt: skip
    """All tasks of a suite; `quick` leaves every second level out. ValueError for names that nobody knows."""
    for name in associators:
        find_associator(name)
    for name in relocators:
        resolve_relocator(name)
    tasks = []
    for name in experiments:
        asked = tuple(relocators if name == RELOCATION else associators)
        for level in find_experiment(name).levels[:: 2 if quick else 1]:
            tasks += [World(level.id, k, asked, problems_each, split) for k in range(count if asked else 0)]
    return tasks


def find_experiment(name: str) -> Experiment:
    """ValueError lists the known ones."""
    if name not in EXPERIMENTS:
        raise ValueError(f"unknown experiment {name!r}; known: {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name]


def by_world(records: Sequence[Record], name: str, experiment: str, key: str = "score") -> dict[int, float]:
    """World → mean over the levels of an experiment, for the worlds that have been through all of its levels."""
    of: dict[int, dict[str, float]] = {}
    for record in records:
        if record["associator"] == name and record["experiment"] == experiment and math.isfinite(record[key]):
            of.setdefault(record["episode"], {})[record["setting"]] = record[key]
    levels = {r["setting"] for r in records if r["experiment"] == experiment}
    return {world: float(np.mean(list(found.values()))) for world, found in of.items() if len(found) == len(levels)}


def over_all(records: Sequence[Record], name: str, experiments: Sequence[str], key: str = "score") -> dict[int, float]:
    """World → mean over experiments."""
    each = [by_world(records, name, experiment, key) for experiment in experiments]
    common = set.intersection(*map(set, each)) if each else set()
    return {world: float(np.mean([found[world] for found in each])) for world in sorted(common)}


def number(of: dict[int, float]) -> Interval:
    """Interquartile mean over worlds, with its interval."""
    return estimate(np.array([of[world] for world in sorted(of)], dtype=float))


def difference(a: dict[int, float], b: dict[int, float]) -> Interval:
    """Of the worlds that both have: paired."""
    common = sorted(a.keys() & b.keys())
    return estimate(np.array([a[world] - b[world] for world in common], dtype=float))


def level_curve(records: Sequence[Record], name: str, experiment: str, key: str) -> tuple[Array, list[Interval]]:
    """Knobs (l,) and the estimate at each."""
    own = [r for r in records if r["associator"] == name and r["experiment"] == experiment]
    knobs = list(dict.fromkeys(record["knob"] for record in own))
    found = [estimate(np.array([r[key] for r in own if r["knob"] == knob], dtype=float)) for knob in knobs]
    return np.array(knobs, dtype=float), found


def capabilities(records: Sequence[Record]) -> list[str]:
    """The experiments of associators among the records, in their order."""
    found = {record["experiment"] for record in records}
    return [name for name in EXPERIMENTS if name in found and name != RELOCATION]


def names_of(records: Sequence[Record], relocators: bool = False) -> list[str]:
    """Who was asked, in order: associators, or relocators."""
    return list(dict.fromkeys(r["associator"] for r in records if (r["experiment"] == RELOCATION) == relocators))


def ranked(records: Sequence[Record]) -> list[str]:
    """Associators by their mean over all capabilities, best first."""
    shown = capabilities(records)
    scores = {name: number(over_all(records, name, shown)).estimate for name in names_of(records)}
    return sorted(scores, key=lambda name: -scores[name] if math.isfinite(scores[name]) else math.inf)


def tables(records: Sequence[Record]) -> dict[str, Any]:
    """`numbers`: associator → capability → estimate, `all` being their mean; `relocation` likewise, with outcomes."""
    shown = capabilities(records)
    numbers: dict[str, Any] = {}
    for name in names_of(records):
        numbers[name] = {e: number(by_world(records, name, e)) for e in shown}
        numbers[name]["all"] = number(over_all(records, name, shown))
    relocation = {}
    for name in names_of(records, relocators=True):
        own = [r for r in records if r["associator"] == name and r["experiment"] == RELOCATION]
        relocation[name] = {RELOCATION: number(by_world(records, name, RELOCATION))}
        relocation[name] |= {outcome: sum(r[outcome] for r in own) for outcome in OUTCOMES}
    return {"numbers": numbers, "relocation": relocation}
