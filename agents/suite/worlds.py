"""The tasks of the association suite: each evaluates all associators or relocators in one world of one level."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import pandas as pd

from agents.evaluation.associators import Metered, find_associator
from agents.evaluation.pipeline import Evaluation, Key, Task
from agents.evaluation.records import Record
from agents.options import Suite
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
from slam_gym.association import resolve_relocator
from slam_gym.association.prediction import Associator
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION, get_level
from slam_gym.types import Hypothesis, IntArray, Relocator
from slam_gym.validation import one_of

WORLDS, PROBLEMS = 24, 12  # worlds of a level; largest number of problems of a world
QUICK_WORLDS, QUICK_PROBLEMS = 4, 8


def suite_evaluation(options: Suite, associators: Sequence[str], relocators: Sequence[str], split: str) -> Evaluation:
    """The evaluation of all associators and relocators on every level. Raises ValueError for unknown names."""
    worlds = options.worlds or (QUICK_WORLDS if options.quick else WORLDS)
    count = options.problems or (QUICK_PROBLEMS if options.quick else PROBLEMS)
    for name in associators:
        find_associator(name)
    for name in relocators:
        resolve_relocator(name)
    tasks = []
    for name in dict.fromkeys(options.experiments or EXPERIMENTS):
        one_of("experiment", name, EXPERIMENTS)
        for level in EXPERIMENTS[name].levels[:: 2 if options.quick else 1]:
            for world in range(worlds):
                names = relocators if name == RELOCATION else associators
                keys = [Key(each, level.id, world) for each in names]
                tasks.append(Task(keys, partial(evaluate_all, level.id, world, names, count, split)))
    size = {"worlds": worlds, "problems": count, "quick": options.quick, "split": split}
    return Evaluation("suite", tasks, size)


def evaluate_all(setting: str, world: int, names: Sequence[str], count: int, split: str) -> list[Record]:
    """The record of each associator, or relocator, for up to `count` problems in one world of one level."""
    level = get_level(setting)
    if level.experiment == RELOCATION:
        records = relocate(setting, world, {name: resolve_relocator(name) for name in names}, count, split)
    else:
        records = associate(setting, world, {name: find_associator(name) for name in names}, count, split)
    return [{"experiment": level.experiment, "knob": level.knob} | records[name] for name in names]


def associate(
    level: str, world: int, associators: Mapping[str, Associator], count: int, split: str = "test"
) -> dict[str, Record]:
    """The records of associators, by name, for up to `count` problems of a world."""
    meters = {name: Metered(partial(ask, name, associate)) for name, associate in associators.items()}
    answers: dict[str, list[Hypothesis]] = {name: [] for name in associators}
    right: list[IntArray] = []
    for problem in problems(TwoLaps(get_level(level), world, split), count):
        right.append(problem.truth.right)
        for name, meter in meters.items():
            answers[name].append(meter(problem))
    return {
        name: association_record([judge(h.features, r) for h, r in zip(own, right)])
        | meters[name].effort() | promised(own, right)
        for name, own in answers.items()
    }  # fmt: skip


def relocate(
    level: str, world: int, searches: Mapping[str, Relocator], count: int, split: str = "test"
) -> dict[str, Record]:
    """The records of relocators, by name, for up to `count` problems of a world."""
    meters = {name: Metered(search) for name, search in searches.items()}
    outcomes: dict[str, Counter[str]] = {name: Counter() for name in searches}
    for problem in relocation_problems(get_level(level), world, count, split):
        for name, meter in meters.items():
            relocation = meter(problem.scan, problem.landmarks, problem.locality)
            outcomes[name][judge_relocation(relocation, problem.pose)] += 1
    return {name: relocation_record(outcomes[name]) | meters[name].effort() for name in searches}


def association_record(judged: Sequence[Judgement]) -> Record:
    """Fractions over the problems of a world; NaN where it had none.

    The score is the mean over scans, but not below 0. `spoiled` are scans with a wrong pairing; in `exact` scans, all
    measurements of mapped features are paired rightly and no others are paired.
    """
    scans = pd.DataFrame(judged, columns=Judgement._fields, dtype=float)
    right, wrong, refused, mapped = (scans[name] for name in Judgement._fields)
    return {
        "problems": len(scans),
        "score": float(max(pd.Series([j.score for j in judged], dtype=float).mean(), 0.0)),  # NaN stays
        "spoiled": float((wrong > 0.0).mean()),
        "refused": float((refused / mapped).mean()),
        "exact": float((wrong + refused == 0.0).mean()),
        "precision": _ratio(right.sum(), right.sum() + wrong.sum()),
        "recall": _ratio(right.sum(), mapped.sum()),
    }


def promised(answers: Sequence[Hypothesis], right: Sequence[IntArray]) -> Record:
    """The mean probability of the best hypothesis of a scan, and the rate at which it is right, `*` included; NaN
    without probabilities. The two agree where the posterior is calibrated."""
    p, hit = [], []
    for hypothesis, of_truth in zip(answers, right):
        if (posterior := hypothesis.posterior) is not None:
            decided = posterior.probability >= posterior.runner_up_probability
            best = hypothesis.features if decided else posterior.runner_up
            p.append(max(posterior.probability, posterior.runner_up_probability))
            hit.append(bool((best == of_truth).all()))
    return {"promised": float(np.mean(p or math.nan)), "kept": float(np.mean(hit or math.nan))}


def _ratio(part: float, whole: float) -> float:
    return float(part / whole) if whole else math.nan


def relocation_record(counts: Counter[str]) -> Record:
    """Outcomes and their score: (fraction correct − wrong inside, not below 0) · (fraction refused outside)."""
    inside = counts["correct"] + counts["silent"] + counts["wrong"]
    outside = counts["refused"] + counts["invented"]
    score = _ratio(max(0, counts["correct"] - counts["wrong"]), inside) * _ratio(counts["refused"], outside)
    return {"problems": inside + outside, "score": score, **{name: counts[name] for name in OUTCOMES}}
