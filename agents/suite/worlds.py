"""The tasks of the association suite: one world of one level, about which everybody is asked."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from agents.evaluation.associators import Metered, find_associator
from agents.evaluation.pipeline import Evaluation
from agents.evaluation.records import Key, Record
from agents.suite.problems import (
    OUTCOMES,
    Judgement,
    TwoLaps,
    ask,
    judge,
    judge_relocation,
    problems,
    relocation_problems,
)
from agents.suite.reliability import binned, promised
from slam_gym.association import resolve_relocator
from slam_gym.association.prediction import Associator
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION, get_level
from slam_gym.types import Hypothesis, IntArray, Relocator
from slam_gym.validation import one_of


@dataclass(frozen=True)
class SuiteSize:
    """How much of the suite is run."""

    worlds: int = 24  # a level
    problems: int = 12  # a world, at most
    quick: bool = False  # every second level is left out
    split: str = "test"


@dataclass(frozen=True)
class WorldTask:
    """One world of one level, and who is asked about it: associators, or relocators where it is about relocation."""

    setting: str  # id of the level
    episode: int  # number of the world
    names: tuple[str, ...]
    problems: int
    split: str = "test"

    @property
    def keys(self) -> tuple[Key, ...]:
        return tuple(Key(name, self.setting, self.episode) for name in self.names)

    def run(self, wanted: Sequence[Key]) -> list[Record]:
        level, names = get_level(self.setting), [key.name for key in wanted]
        if level.experiment == RELOCATION:
            found = self.relocate({name: resolve_relocator(name) for name in names})
        else:
            found = self.associate({name: find_associator(name) for name in names})
        about = {"experiment": level.experiment, "knob": level.knob}
        return [key._asdict() | about | found[key.name] for key in wanted]

    def associate(self, associators: Mapping[str, Associator]) -> dict[str, Record]:
        """What associators make of the problems of the world, by their names."""
        meters = {name: Metered(partial(ask, name, associate)) for name, associate in associators.items()}
        answers: dict[str, list[Hypothesis]] = {name: [] for name in associators}
        right: list[IntArray] = []
        for problem in problems(TwoLaps(get_level(self.setting), self.episode, self.split), self.problems):
            right.append(problem.truth.right)
            for name, meter in meters.items():
                answers[name].append(meter(problem))
        return {
            name: association_record([judge(h.features, r) for h, r in zip(own, right)])
            | meters[name].effort() | {"reliability": binned(own, right)} | promised(own, right)
            for name, own in answers.items()
        }  # fmt: skip

    def relocate(self, searches: Mapping[str, Relocator]) -> dict[str, Record]:
        """What relocators make of the problems of the world, by their names."""
        meters = {name: Metered(search) for name, search in searches.items()}
        outcomes: dict[str, Counter[str]] = {name: Counter() for name in searches}
        for problem in relocation_problems(get_level(self.setting), self.episode, self.problems, self.split):
            for name, meter in meters.items():
                found = meter(problem.scan, problem.landmarks, problem.locality)
                outcomes[name][judge_relocation(found, problem.pose)] += 1
        return {name: relocation_record(outcomes[name]) | meters[name].effort() for name in searches}


def association_record(judged: Sequence[Judgement]) -> Record:
    """Fractions over the problems of a world; NaN where it had none. The score is that of the scans, but not below
    0."""
    mapped, paired = sum(j.mapped for j in judged), sum(j.right + j.wrong for j in judged)
    right = sum(j.right for j in judged)
    per_scan = {
        "score": [j.score for j in judged],
        "spoiled": [j.wrong > 0 for j in judged],
        "refused": [j.refused / j.mapped for j in judged],
        "exact": [j.exact for j in judged],
    }
    means = {key: float(np.mean(values)) if values else math.nan for key, values in per_scan.items()}
    return {
        "problems": len(judged),
        **means,
        "score": max(means["score"], 0.0),  # NaN stays
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
        names = tuple(relocators if experiment.name == RELOCATION else associators)
        for level in experiment.levels[:: 2 if size.quick else 1]:
            worlds = range(size.worlds if names else 0)
            tasks += [WorldTask(level.id, k, names, size.problems, size.split) for k in worlds]
    return Evaluation("suite", tasks, vars(size))
