"""The tasks of the association suite: one world of one level, about which everybody is asked."""

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

WORLDS, PROBLEMS = 24, 12  # of a level; of a world, at most
QUICK_WORLDS, QUICK_PROBLEMS = 4, 8


def suite_evaluation(options: Suite, associators: Sequence[str], relocators: Sequence[str], split: str) -> Evaluation:
    """Everybody asked about every level, checked. ValueError for names that nobody knows."""
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
                keys = [Key(who, level.id, world) for who in names]
                tasks.append(Task(keys, partial(ask_all, level.id, world, names, count, split)))
    size = {"worlds": worlds, "problems": count, "quick": options.quick, "split": split}
    return Evaluation("suite", tasks, size)


def ask_all(setting: str, world: int, names: Sequence[str], count: int, split: str) -> list[Record]:
    """What associators make of up to `count` problems in one world of one level; relocators where it is about that."""
    level = get_level(setting)
    if level.experiment == RELOCATION:
        found = relocate(setting, world, {name: resolve_relocator(name) for name in names}, count, split)
    else:
        found = associate(setting, world, {name: find_associator(name) for name in names}, count, split)
    return [{"experiment": level.experiment, "knob": level.knob} | found[name] for name in names]


def associate(
    level: str, world: int, associators: Mapping[str, Associator], count: int, split: str = "test"
) -> dict[str, Record]:
    """What associators make of up to `count` problems of a world, by their names."""
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
    """What relocators make of up to `count` problems of a world, by their names."""
    meters = {name: Metered(search) for name, search in searches.items()}
    outcomes: dict[str, Counter[str]] = {name: Counter() for name in searches}
    for problem in relocation_problems(get_level(level), world, count, split):
        for name, meter in meters.items():
            found = meter(problem.scan, problem.landmarks, problem.locality)
            outcomes[name][judge_relocation(found, problem.pose)] += 1
    return {name: relocation_record(outcomes[name]) | meters[name].effort() for name in searches}


def association_record(judged: Sequence[Judgement]) -> Record:
    """Fractions over the problems of a world; NaN where it had none.

    The score is the mean over scans, but not below 0. `spoiled` are scans with a wrong pairing; in `exact` ones, all
    that is mapped is paired rightly and nothing else is paired.
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
    """Of scans: the mean probability of the best hypothesis, and the rate at which it is right, `*` included; NaN where
    nobody says how probable it is. Where the posterior is calibrated the two agree."""
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
    """Outcomes, and their score: (correct − wrong, of those inside, not below 0) · (refused, of those outside)."""
    inside = counts["correct"] + counts["silent"] + counts["wrong"]
    outside = counts["refused"] + counts["invented"]
    score = _ratio(max(0, counts["correct"] - counts["wrong"]), inside) * _ratio(counts["refused"], outside)
    return {"problems": inside + outside, "score": score, **{name: counts[name] for name in OUTCOMES}}
