"""The tasks of the association suite: one world of one level, about which everybody is asked."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agents.evaluation.associators import find_associator
from agents.evaluation.pipeline import SUITE, Evaluation
from agents.evaluation.records import Key, Record
from agents.suite.numbers import numbers
from agents.suite.problems import Judgement, TwoLaps, ask, judge, problems
from agents.suite.reliability import binned, promised
from agents.suite.relocation_problems import OUTCOMES, judge_relocation, relocation_problems
from slam_gym.association import resolve_relocator
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION, get_level
from slam_gym.types import Associator, Effort, Hypothesis, IntArray, Relocator
from slam_gym.validation import one_of


@dataclass(frozen=True)
class WorldTask:
    """One world of one level, and who is asked about it: associators, or relocators where it is about relocation."""

    setting: str  # id of the level
    episode: int  # number of the world
    asked: tuple[str, ...]
    problems: int
    split: str = "test"

    @property
    def keys(self) -> tuple[Key, ...]:
        return tuple(Key(name, self.setting, self.episode) for name in self.asked)

    def run(self, wanted: Sequence[Key]) -> list[Record]:
        level, names = get_level(self.setting), [key.name for key in wanted]
        about = {"setting": self.setting, "episode": self.episode, "experiment": level.experiment, "knob": level.knob}
        if level.experiment == RELOCATION:
            found = self.relocate({name: resolve_relocator(name) for name in names})
        else:
            found = self.associate({name: find_associator(name) for name in names})
        return [{"associator": name} | about | record for name, record in found.items()]

    def associate(self, asked: Mapping[str, Associator]) -> dict[str, Record]:
        """What associators make of the problems of the world, by their names."""
        judged: dict[str, list[Judgement]] = {name: [] for name in asked}
        answers: dict[str, list[Hypothesis]] = {name: [] for name in asked}
        right: list[IntArray] = []
        efforts: dict[str, list[_Spent]] = {name: [] for name in asked}
        for problem in problems(TwoLaps(get_level(self.setting), self.episode, self.split), self.problems):
            right.append(problem.truth.right)
            for name, associate in asked.items():
                start = time.perf_counter()
                hypothesis = ask(name, associate, problem)
                efforts[name].append(_Spent(hypothesis.effort, time.perf_counter() - start))
                answers[name].append(hypothesis)
                judged[name].append(judge(hypothesis.features, problem.truth.right))
        return {
            name: association_record(judged[name])
            | _effort_record(efforts[name])
            | {"reliability": binned(answers[name], right)}
            | promised(answers[name], right)
            for name in asked
        }

    def relocate(self, asked: Mapping[str, Relocator]) -> dict[str, Record]:
        """What relocators make of the problems of the world, by their names."""
        outcomes: dict[str, Counter[str]] = {name: Counter() for name in asked}
        efforts: dict[str, list[_Spent]] = {name: [] for name in asked}
        for problem in relocation_problems(get_level(self.setting), self.episode, self.problems, self.split):
            for name, search in asked.items():
                start = time.perf_counter()
                found = search(problem.scan, problem.landmarks, problem.locality)
                efforts[name].append(_Spent(found.effort, time.perf_counter() - start))
                outcomes[name][judge_relocation(found, problem.pose)] += 1
        return {name: relocation_record(outcomes[name]) | _effort_record(efforts[name]) for name in asked}


class _Spent(NamedTuple):
    effort: Effort
    seconds: float


def association_record(judged: Sequence[Judgement]) -> Record:
    """Fractions over the problems of a world; NaN where it had none. The score is that of the scans, but not below
    0."""
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


def relocation_record(counts: Counter[str]) -> Record:
    """Outcomes, and their score: (correct − wrong, of those inside, not below 0) · (refused, of those outside)."""
    inside = counts["correct"] + counts["silent"] + counts["wrong"]
    outside = counts["refused"] + counts["invented"]
    known = inside > 0 and outside > 0
    gain = max(0, counts["correct"] - counts["wrong"]) / inside if known else math.nan
    score = gain * counts["refused"] / outside if known else math.nan
    return {"problems": inside + outside, "score": score, **{name: counts[name] for name in OUTCOMES}}


def _effort_record(efforts: Sequence[_Spent]) -> Record:
    return {
        "nodes": _mean(spent.effort.nodes for spent in efforts),
        "microseconds": 1e6 * float(np.median([spent.seconds for spent in efforts])) if efforts else math.nan,
        "limits": sum(spent.effort.limit_hit for spent in efforts),
    }


def _mean(values: Iterable[float]) -> float:
    found = list(values)
    return float(np.mean(found)) if found else math.nan


@dataclass(frozen=True)
class SuiteSize:
    """How much of the suite is run."""

    worlds: int = 24  # a level
    problems: int = 12  # a world, at most
    quick: bool = False  # every second level is left out
    split: str = "test"


def suite_evaluation(
    associators: Sequence[str], relocators: Sequence[str], experiments: Sequence[str], size: SuiteSize
) -> Evaluation:
    """Everybody asked about every level, checked. ValueError for names that nobody knows."""
    for name in associators:
        find_associator(name)
    for name in relocators:
        resolve_relocator(name)
    tasks = []
    for name in experiments:
        one_of("experiment", name, EXPERIMENTS)
    for experiment in (EXPERIMENTS[name] for name in experiments):
        asked = tuple(relocators if experiment.name == RELOCATION else associators)
        for level in experiment.levels[:: 2 if size.quick else 1]:
            worlds = range(size.worlds if asked else 0)
            tasks += [WorldTask(level.id, k, asked, size.problems, size.split) for k in worlds]
    return Evaluation(SUITE, tasks, vars(size), numbers)
