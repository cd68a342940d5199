"""The relocation problems of the suite: half in the map, half in another building, and answers judged by hand."""

import math

import numpy as np

from agents.suite.problems import MIN_MAPPED
from agents.suite.relocation_problems import MAX_DISTANCE, MAX_TURN, judge_relocation, relocation_problems
from slam_gym.geometry import transform
from slam_gym.scenarios.suite import get_level
from slam_gym.types import Effort, Relocation


def answer(pose, pairings: int) -> Relocation:
    features = np.arange(pairings)
    return Relocation(features, np.array(pose), np.eye(3), 0.0, 2 * pairings - 3, 4, False, 0, Effort())


def test_outcomes_of_a_kidnapping():
    at = np.array([1.0, 2.0, 3.1])
    aside, turned = np.array([MAX_DISTANCE, 0.0, 0.0]), np.array([0.0, 0.0, MAX_TURN])
    assert judge_relocation(answer(at, 5), at) == "correct"
    assert judge_relocation(answer(at + 0.9 * aside, 5), at) == "correct"
    assert judge_relocation(answer(at + 1.1 * aside, 5), at) == "wrong"
    assert judge_relocation(answer(at + 1.1 * turned, 5), at) == "wrong"
    assert judge_relocation(answer((1.0, 2.0, 3.1 - 2.0 * math.pi), 5), at) == "correct"
    assert judge_relocation(answer(at, 3), at) == "silent"
    assert judge_relocation(answer(at, 5), None) == "invented" and judge_relocation(answer(at, 3), None) == "refused"


def test_kidnappings_are_half_inside_the_map_and_half_in_another_building():
    def explained(case, pose) -> float:
        seen = transform(pose, case.scan.points)
        gaps = [np.hypot(*(case.landmarks.positions - point).T).min() for point in seen]
        return float(np.mean(np.array(gaps) < 0.3))

    cases = list(relocation_problems(get_level("kidnapped/0"), 0, 8, "train"))
    inside, outside = [c for c in cases if c.pose is not None], [c for c in cases if c.pose is None]
    assert len(inside) == len(outside) == 4 and all(len(case.scan) >= MIN_MAPPED for case in cases)
    assert all(explained(case, case.pose) > 0.8 for case in inside)
    assert np.mean([explained(case, inside[0].pose) for case in outside]) < 0.6
    assert all(len(case.locality) == len(case.landmarks) for case in cases)
