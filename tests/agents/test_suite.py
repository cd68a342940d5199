"""The problems of the suite are what their level says, the same every time, and judged as by hand; the truth is the
ceiling, refusing earns nothing, and nobody depends on who else is asked."""

import json
import math

import numpy as np
import pytest

from agents.suite import (
    MAX_DISTANCE,
    MAX_TURN,
    MIN_MAPPED,
    AssociationProblem,
    ask,
    association_record,
    evaluate,
    judge_relocation,
    problems,
    relocation_problems,
    relocation_record,
)
from slam_gym.association import ASSOCIATORS, resolve_associator, resolve_relocator
from slam_gym.geometry import transform
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION, Level, get_level
from slam_gym.simulation.judged import CEILING
from slam_gym.types import UNPAIRED, Effort, Hypothesis, Relocation

ASSOCIATION = [name for name in EXPERIMENTS if name != RELOCATION]


def drawn(level: Level, world: int, count: int = 6, split: str = "train") -> list[AssociationProblem]:
    return list(problems(level, world, count, split))


def test_problems_are_the_same_every_time_and_others_in_other_worlds():
    first, again, other = (drawn(get_level("clutter/1"), world) for world in (0, 0, 1))
    assert len(first) == 6
    for a, b in zip(first, again):
        np.testing.assert_array_equal(a.scan.points, b.scan.points)
        np.testing.assert_array_equal(a.prediction.positions, b.prediction.positions)
        np.testing.assert_array_equal(a.truth.right, b.truth.right)
    for elsewhere in (other, drawn(get_level("clutter/1"), 0, split="test")):
        assert not any(np.array_equal(a.scan.points, c.scan.points) for a in first for c in elsewhere)


@pytest.mark.parametrize("name", ASSOCIATION)
def test_a_problem_tells_the_truth_about_itself(name):
    for problem in drawn(get_level(f"{name}/2"), 0):
        assert problem.truth.known >= MIN_MAPPED
        for source, feature in zip(problem.truth.sources, problem.truth.right):
            known = np.flatnonzero(problem.truth.identities == source) if source >= 0 else []
            assert feature == (known[0] if len(known) else UNPAIRED)
        view = problem.prediction.visibility()
        assert view.shape == (len(problem.prediction),) and ((view >= 0.0) & (view <= 1.0)).all()


def test_what_the_pose_is_off_by_is_what_its_covariance_says():
    """D² of right hypotheses follows its χ² law while the pose is not so poor that linearisation fails."""
    total, dof = 0.0, 0
    for problem in (problem for world in range(6) for problem in drawn(get_level("closure/1"), world)):
        hypothesis = ask(CEILING, ASSOCIATORS[CEILING], problem)
        total, dof = total + hypothesis.joint_distance, dof + hypothesis.dof
    assert 0.85 < total / dof < 1.2


def deciding(*features) -> Hypothesis:
    return Hypothesis(np.array(features), 0.0, 0, Effort())


def test_an_answer_is_judged_by_hand():
    right = np.array([3, 5, UNPAIRED, 7, UNPAIRED])

    def earned(*features):
        record = association_record([deciding(*features)], [right])
        return tuple(record[name] for name in ("precision", "recall", "refused", "score", "exact"))

    assert earned(*right) == (1.0, 1.0, 0.0, 1.0, 1.0)
    assert earned(*[UNPAIRED] * 5) == pytest.approx((math.nan, 0.0, 1.0, 0.0, 0.0), nan_ok=True)
    assert earned(3, UNPAIRED, UNPAIRED, 7, UNPAIRED) == pytest.approx((1.0, 2 / 3, 1 / 3, 2 / 3, 0.0))
    assert earned(5, 3, UNPAIRED, 7, UNPAIRED) == pytest.approx((1 / 3, 1 / 3, 0.0, 0.0, 0.0))
    assert earned(3, 5, 9, 7, UNPAIRED) == (0.75, 1.0, 0.0, 0.0, 0.0)
    three = association_record([deciding(*right)] * 2 + [deciding(5, 3, UNPAIRED, 7, UNPAIRED)], [right] * 3)
    assert (three["score"], three["spoiled"], three["precision"]) == pytest.approx((1 / 3, 1 / 3, 7 / 9))  # spoiled: −1
    assert association_record([deciding(*right), deciding(UNPAIRED)], [right, right[:1]])["refused"] == 0.5
    assert math.isnan(association_record([], [])["score"])


@pytest.mark.parametrize(
    ("off", "pairings", "inside", "outcome"),
    [
        ((0.9 * MAX_DISTANCE, 0.0, 2.0 * math.pi), 5, True, "correct"),
        ((1.1 * MAX_DISTANCE, 0.0, 0.0), 5, True, "wrong"),
        ((0.0, 0.0, 1.1 * MAX_TURN), 5, True, "wrong"), ((0.0, 0.0, 0.0), 3, True, "silent"),
        ((0.0, 0.0, 0.0), 5, False, "invented"), ((0.0, 0.0, 0.0), 3, False, "refused"),
    ],
)  # fmt: skip
def test_outcomes_of_a_kidnapping(off, pairings, inside, outcome):
    at = np.array([1.0, 2.0, 3.1])
    answer = Relocation(np.arange(pairings), at + off, np.eye(3), 0.0, 2 * pairings - 3, 4, False, 0, Effort())
    assert judge_relocation(answer, at if inside else None) == outcome


def test_a_wrong_relocation_takes_the_reward_of_a_right_one_and_inventions_that_of_all():
    at = np.array([1.0, 2.0, 3.1])
    right, wrong, silent = (
        Relocation(np.arange(k), at + off, np.eye(3), 0.0, 2 * k - 3, 4, False, 0, Effort())
        for k, off in ((5, 0.0), (5, 1.0), (3, 0.0))
    )
    record = relocation_record([right, right, wrong, silent, silent, wrong], [at, at, at, at, None, None])
    assert record["score"] == (2 - 1) / 4 * 1 / 2


def test_kidnappings_are_half_inside_the_map_and_half_in_another_building():
    def explained(case, pose) -> float:
        seen = transform(pose, case.scan.points)
        gaps = [np.hypot(*(case.landmarks.positions - point).T).min() for point in seen]
        return float(np.mean(np.array(gaps) < 0.3))

    cases = list(relocation_problems(get_level("kidnapped/0"), 0, 8, "train"))
    inside, outside = [c for c in cases if c.right is not None], [c for c in cases if c.right is None]
    assert len(inside) == len(outside) == 4 and all(len(case.scan) >= MIN_MAPPED for case in cases)
    assert all(explained(case, case.right) > 0.8 for case in inside)
    assert np.mean([explained(case, inside[0].right) for case in outside]) < 0.6
    assert all(len(case.locality) == len(case.landmarks) for case in cases)
    assert [case.right is None for case in relocation_problems(get_level("kidnapped/0"), 0, 3, "train")] == [0, 0, 1]


# -- the records of worlds ---------------------------------------------------------------------------------------------


def run(level, world, names, count):
    """The records of some names in a world of the train split."""
    resolve = resolve_relocator if level.startswith(RELOCATION) else resolve_associator
    searches = {name: resolve(name) for name in names}
    return [{"name": name} | found for name, found in zip(names, evaluate(level, world, searches, count, "train"))]


@pytest.mark.parametrize("name", ASSOCIATION)
def test_true_association_is_the_ceiling(name):
    names = ("true_association", "jcbb", "nearest_neighbour", "singles")
    for record in run(EXPERIMENTS[name].levels[-1].id, 0, names, 5):
        assert record["problems"] == 5 and 0.0 <= record["score"] <= 1.0
        if record["name"] == "true_association":
            assert (record["score"], record["exact"], record["spoiled"], record["refused"]) == (1.0, 1.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["closure", "clutter", "density", "dynamics"])
def test_nearest_neighbour_falls_from_one_end_of_the_sweep_to_the_other(name):
    first, last = (
        np.mean([run(level.id, k, ("nearest_neighbour",), 8)[0]["precision"] for k in range(3)])
        for level in (EXPERIMENTS[name].levels[0], EXPERIMENTS[name].levels[-1])
    )
    assert first - last > 0.05


def test_answers_do_not_depend_on_who_else_is_asked():
    names = ("nearest_neighbour", "jcbb", "true_association")
    together = run("dynamics/3", 1, names, 4)
    for name, record in zip(names[1:], together[1:]):
        alone = run("dynamics/3", 1, (name,), 4)[0]
        drop = {"microseconds": 0.0}
        assert json.dumps(alone | drop) == json.dumps(record | drop)


NOWHERE = (np.zeros(3), np.eye(3), 0.0, 0, 4, False, 0, Effort())


def hasty(scan, landmarks, locality):
    landmarks.positions[:] += 1.0


def sloppy(scan, landmarks, locality):
    return Relocation(np.arange(len(scan)) + 10_000, *NOWHERE)


@pytest.mark.parametrize(("name", "what"), [("hasty", "read-only"), ("sloppy", "relocator sloppy: .*10000")])
def test_a_relocator_spoils_nothing_of_others_and_its_errors_name_it(name, what):
    with pytest.raises(ValueError, match=what) as raised:
        run("kidnapped/0", 0, (f"{__name__}:{name}", "gcbb"), 4)
    assert name in str(raised.value) or raised.value.__notes__ == [f"raised by relocator {name}"]
