"""The association suite: frozen settings, problems that are what their level says, scores with the truth as ceiling."""

import functools
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from agents.suite.problems import LEAST, Course, Judgement, Problem, ask, judge, problems
from agents.suite.relocation import NEAR, TURNED, kidnappings, outcome
from agents.suite.run import World, by_world, capabilities, difference, number, over_all, ranked, tables, worlds
from slam_gym.association import true_association
from slam_gym.association.compatibility import individual
from slam_gym.geometry import transform
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION, Level, get_level
from slam_gym.types import NONE, Effort, Hypothesis, Relocation

ASSOCIATION = [name for name in EXPERIMENTS if name != RELOCATION]


def drawn(level: Level, world: int, count: int = 6, split: str = "train") -> list[Problem]:
    return list(problems(Course(level, world, split), count))


@functools.cache
def pool(id: str, seeds: int = 2) -> list[Problem]:
    return [problem for world in range(seeds) for problem in drawn(get_level(id), world)]


def test_problems_are_the_same_every_time_and_others_in_other_worlds():
    first, again, other = (drawn(get_level("clutter/1"), world) for world in (0, 0, 1))
    assert len(first) == 6
    for a, b in zip(first, again):
        np.testing.assert_array_equal(a.scan.points, b.scan.points)
        np.testing.assert_array_equal(a.prediction.positions, b.prediction.positions)
        np.testing.assert_array_equal(a.right, b.right)
    assert all(a.scan.points.shape != c.scan.points.shape or (a.scan.points != c.scan.points).any()
               for a in first for c in other)  # fmt: skip
    test = drawn(get_level("clutter/1"), 0, split="test")
    assert all(a.scan.points.shape != c.scan.points.shape or (a.scan.points != c.scan.points).any()
               for a in first for c in test)  # fmt: skip


@pytest.mark.parametrize("name", ASSOCIATION)
def test_a_problem_tells_the_truth_about_itself(name):
    for problem in pool(f"{name}/2"):
        assert (problem.right != NONE).sum() >= LEAST
        for source, feature in zip(problem.sources, problem.right):
            known = np.flatnonzero(problem.identities == source) if source >= 0 else []
            assert feature == (known[0] if len(known) else NONE)
        view = problem.prediction.visibility
        assert view.shape == (len(problem.prediction),) and ((view >= 0.0) & (view <= 1.0)).all()


@pytest.mark.parametrize("name", ASSOCIATION)
@pytest.mark.parametrize("end", [0, -1])
def test_true_association_is_the_ceiling(name, end):
    level = EXPERIMENTS[name].levels[end]
    names = ("true_association", "jcbb", "nearest_neighbour", "singles")
    for record in World(level.id, 0, names, 5, "train").run():
        assert record["problems"] == 5 and 0.0 <= record["score"] <= 1.0
        if record["associator"] == "true_association":
            assert (record["score"], record["exact"], record["spoiled"], record["refused"]) == (1.0, 1.0, 0.0, 0.0)


def test_what_the_pose_is_off_by_is_what_its_covariance_says():
    """D² of right hypotheses follows its χ² law while the pose is not so poor that linearisation fails."""
    total, dof = 0.0, 0
    for problem in pool("closure/1", 6):
        hypothesis = ask(true_association, problem)
        total, dof = total + hypothesis.joint_distance, dof + hypothesis.dof
    assert 0.85 < total / dof < 1.2


def candidates(id: str) -> float:
    """Individually compatible features per measurement."""
    found = [individual(problem.scan, problem.prediction) for problem in pool(id)]
    return sum(len(f.slots) for f in found) / sum(len(problem.scan) for problem in pool(id))


@pytest.mark.parametrize("name", ["closure", "density"])
def test_a_poorer_pose_and_closer_features_bring_more_candidates(name):
    counts = [candidates(level.id) for level in EXPERIMENTS[name].levels]
    assert counts[0] < 1.4 and counts[-1] > 2.5 and counts[0] < counts[2] < counts[-1]


@pytest.mark.parametrize("name", ["clutter", "dynamics"])
def test_clutter_and_people_bring_spurious_measurements(name):
    shares = [np.mean(np.concatenate([problem.sources == NONE for problem in pool(level.id)]))
              for level in EXPERIMENTS[name].levels]  # fmt: skip
    assert shares[0] == 0.0 and shares[-1] > 0.2 and shares == sorted(shares)


def test_a_detector_that_misses_shows_less():
    mapped = [np.mean([(problem.right != NONE).sum() for problem in pool(level.id)])
              for level in EXPERIMENTS["detection"].levels]  # fmt: skip
    assert mapped[-1] < 0.6 * mapped[0]


@pytest.mark.parametrize("name", ["closure", "clutter", "density", "dynamics"])
def test_nearest_neighbour_falls_from_one_end_of_the_sweep_to_the_other(name):
    first, last = (
        np.mean([World(level.id, k, ("nearest_neighbour",), 8, "train").run()[0]["precision"] for k in range(3)])
        for level in (EXPERIMENTS[name].levels[0], EXPERIMENTS[name].levels[-1])
    )
    assert first - last > 0.05


def problem_of(right: list[int]) -> Problem:
    given = pool("closure/0")[0]
    return replace(given, right=np.array(right))


def test_an_answer_is_judged_by_hand():
    problem = problem_of([3, 5, NONE, 7, NONE])
    perfect = judge(np.array([3, 5, NONE, 7, NONE]), problem)
    assert perfect == Judgement(3, 0, 0, 3) and perfect.exact and perfect.score == 1.0
    assert judge(np.full(5, NONE), problem).score == 0.0
    partly = judge(np.array([3, NONE, NONE, 7, NONE]), problem)
    assert partly == Judgement(2, 0, 1, 3) and partly.score == pytest.approx(2 / 3) and not partly.exact
    swapped = judge(np.array([5, 3, NONE, 7, NONE]), problem)
    assert swapped == Judgement(1, 2, 0, 3) and swapped.score == -1.0
    spurious = judge(np.array([3, 5, 9, 7, NONE]), problem)
    assert spurious == Judgement(3, 1, 0, 3) and spurious.score == -1.0
    with pytest.raises(ValueError, match="4 decisions for 5 measurements"):
        judge(np.full(4, NONE), problem)


def refuse(scan, prediction):
    return Hypothesis(np.full(len(scan), NONE), 0.0, 0, Effort(nodes=len(scan)))


def test_refusing_everything_earns_nothing():
    record = World("density/1", 0, (f"{__name__}:refuse",), 4, "train").run()[0]
    assert record["score"] == 0.0 and record["refused"] == 1.0 and record["spoiled"] == 0.0
    assert math.isnan(record["precision"]) and record["recall"] == 0.0


def test_answers_do_not_depend_on_who_else_is_asked():
    names = ("nearest_neighbour", "jcbb", "true_association")
    together = World("dynamics/3", 1, names, 4, "train").run()
    for name, record in zip(names, together):
        alone = World("dynamics/3", 1, (name,), 4, "train").run()[0]
        drop = {"microseconds": 0.0}
        assert json.dumps(alone | drop) == json.dumps(record | drop)


def test_what_is_done_is_left_out_of_a_task():
    task = World("closure/0", 2, ("jcbb", "singles"), 4)
    assert task.without(set()) == task
    assert task.without({("jcbb", "closure/0", 2)}).asked == ("singles",)
    assert task.without({("jcbb", "closure/0", 1)}) == task
    assert task.without(set(task.keys)) is None


def located(pose, pairings: int) -> Relocation:
    features = np.arange(pairings)
    return Relocation(features, np.array(pose), np.eye(3), 0.0, 2 * pairings - 3, 4, False, 0, Effort())


def test_outcomes_of_a_kidnapping():
    at = np.array([1.0, 2.0, 3.1])
    aside, turned = np.array([NEAR, 0.0, 0.0]), np.array([0.0, 0.0, TURNED])
    assert outcome(located(at, 5), at) == "correct"
    assert outcome(located(at + 0.9 * aside, 5), at) == "correct"
    assert outcome(located(at + 1.1 * aside, 5), at) == "wrong"
    assert outcome(located(at + 1.1 * turned, 5), at) == "wrong"
    assert outcome(located((1.0, 2.0, 3.1 - 2.0 * math.pi), 5), at) == "correct"
    assert outcome(located(at, 3), at) == "silent"
    assert outcome(located(at, 5), None) == "invented" and outcome(located(at, 3), None) == "refused"


def test_kidnappings_are_half_inside_the_map_and_half_in_another_building():
    def explained(case, pose) -> float:
        seen = transform(pose, case.scan.points)
        gaps = [np.hypot(*(case.landmarks.positions - point).T).min() for point in seen]
        return float(np.mean(np.array(gaps) < 0.3))

    cases = list(kidnappings(get_level("kidnapped/0"), 0, 8, "train"))
    inside, outside = [c for c in cases if c.pose is not None], [c for c in cases if c.pose is None]
    assert len(inside) == len(outside) == 4 and all(len(case.scan) >= LEAST for case in cases)
    assert all(explained(case, case.pose) > 0.8 for case in inside)
    assert np.mean([explained(case, inside[0].pose) for case in outside]) < 0.6
    assert all(len(case.locality) == len(case.landmarks) for case in cases)


def silent(scan, landmarks, locality):
    return located(np.zeros(3), 0)


def eager(scan, landmarks, locality):
    return located(np.zeros(3), 99)


def test_neither_silence_nor_eagerness_pays():
    names = (f"{__name__}:silent", f"{__name__}:eager")
    quiet, loud = World("kidnapped/0", 0, names, 8, "train").run()
    assert (quiet["score"], quiet["silent"], quiet["refused"]) == (0.0, 4, 4)
    assert (loud["score"], loud["correct"], loud["invented"]) == (0.0, 0, 4)


def records_of(scores: dict[str, dict[str, list[list[float]]]]) -> list[dict]:
    """name → experiment → (levels, worlds) of scores, as records."""
    return [
        {"associator": name, "experiment": e, "setting": f"{e}/{i}", "knob": float(i), "episode": w, "score": score}
        for name, of in scores.items()
        for e, levels in of.items()
        for i, row in enumerate(levels)
        for w, score in enumerate(row)
    ]


def test_numbers_are_means_over_levels_then_over_worlds():
    records = records_of({
        "a": {"closure": [[1.0, 0.8], [0.6, 0.4]], "clutter": [[0.5, 0.5], [0.1, 0.3]]},
        "b": {"closure": [[0.9, 0.7], [0.5, 0.3]], "clutter": [[0.4, 0.4], [0.0, 0.2]]},
    })  # fmt: skip
    assert capabilities(records) == ["closure", "clutter"]
    assert by_world(records, "a", "closure") == pytest.approx({0: 0.8, 1: 0.6})
    assert over_all(records, "a", ["closure", "clutter"]) == pytest.approx({0: 0.55, 1: 0.5})
    assert tables(records)["numbers"]["a"]["all"].estimate == pytest.approx(0.525)
    assert ranked(records) == ["a", "b"]
    gap = difference(by_world(records, "a", "clutter"), by_world(records, "b", "clutter"))
    assert (gap.estimate, gap.low, gap.high) == pytest.approx((0.1, 0.1, 0.1))  # paired: worlds do not blur it
    assert number({}).estimate != number({}).estimate


def test_a_world_that_has_not_been_through_all_levels_does_not_count():
    records = records_of({"a": {"closure": [[1.0, 0.8], [0.6, 0.4]]}})[:-1]
    assert by_world(records, "a", "closure") == pytest.approx({0: 0.8})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"associators": ["nn"]}, "'nn'; known: .*jcbb"),
        ({"relocators": ["gps"]}, "'gps'; known: .*gcbb"),
        ({"experiments": ["fog"]}, "'fog'; known: closure"),
    ],
)
def test_names_that_nobody_knows_are_refused_with_those_that_are(changes, said):
    given = {"associators": ["jcbb"], "relocators": [], "experiments": ["closure"]} | changes
    with pytest.raises(ValueError, match=said):
        worlds(**given, count=1, problems_each=1)
