"""What the learned acceptance is trained on: answers of the search, from inside a map and from other buildings."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from agents.suite.relocation_problems import RelocationProblem, judge_relocation, relocation_problems
from slam_gym.association.learned.acceptance import INPUTS, inputs_of, of_mirror_image
from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.scenarios.suite import get_level
from slam_gym.types import Array

CONFIDENCE, NODE_LIMIT = 0.99, 1_000_000
BEYOND_RULE = INPUTS.index("pairings beyond the rule")
_FEWEST = 3


class Answer(NamedTuple):
    """One answer that might be accepted."""

    inputs: Array  # (inputs,)
    right: bool  # the pose found is where the robot is
    inside: bool  # it is in the map
    by_rule: bool  # the rule of the search would accept it


class Asked(NamedTuple):
    """The problems of a level in one world."""

    answers: list[Answer]
    inside: int  # problems, whether answered or not
    outside: int


def asked(level: str, world: int, count: int, split: str = "train") -> Asked:
    """Up to `count` problems: half from inside, half from outside."""
    answers, number = [], {True: 0, False: 0}
    for problem in relocation_problems(get_level(level), world, count, split):
        number[problem.pose is not None] += 1
        answers += list(_answer(problem))
    return Asked(answers, number[True], number[False])


def _answer(problem: RelocationProblem) -> Iterator[Answer]:
    """That of the search, if it is one."""
    scan, landmarks, locality = problem.scan, problem.landmarks, problem.locality
    found = gcbb(scan, landmarks, locality, confidence=CONFIDENCE, min_pairings=_FEWEST, node_limit=NODE_LIMIT)
    if not found.accepted or found.effort.limit_hit:
        return
    mirrored = of_mirror_image(scan, landmarks, locality, CONFIDENCE, NODE_LIMIT // 10)
    about = inputs_of(scan, landmarks, found, mirrored)
    right = judge_relocation(found, problem.pose) == "correct"
    yield Answer(about, right, problem.pose is not None, bool(about[BEYOND_RULE] >= 0.0))
