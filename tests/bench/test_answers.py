"""Relocations judged and counted."""

import numpy as np
import pytest

from slam_gym.bench.answers import ACCEPTED, Tolerance, attempt, count_answers, proportion, without_sizes
from slam_gym.types import Effort, Landmarks, Relocation, Scan


def record(**changes):
    return {"inside": True, "right": False, "pairings": 5, "accepted": False, "ambiguous": False} | changes


@pytest.mark.parametrize(("off", "right"), [((0.2, 0.0, 0.0), True), ((0.2, 0.3, 0.0), False), ((0, 0, 0.2), False)])
def test_poses_are_right_within_a_tolerance_across_the_cut_of_the_angle(off, right):
    true = np.array([1.0, 2.0, 3.1])
    near = Tolerance(0.3, 0.1)
    assert near.holds(true + off, true) is right and near.holds(true - off, true) is right
    assert near.holds(np.array([1.0, 2.0, 3.15 - 2 * np.pi]), true)
    assert not near.holds(np.full(3, np.nan), true) and not near.holds(true, np.full(3, np.nan))


def test_every_scan_counts_once_and_answers_become_fewer():
    rng = np.random.default_rng(1)
    rows = [
        record(
            inside=bool(rng.random() < 0.6),
            pairings=int(rng.integers(0, 10)),
            right=bool(rng.random() < 0.5),
            accepted=bool(rng.random() < 0.3),
            ambiguous=bool(rng.random() < 0.4),
        )
        for _ in range(300)
    ]
    found = {asked: count_answers(rows, asked) for asked in (ACCEPTED, *range(3, 10))}
    inside = sum(row["inside"] for row in rows)
    for c in found.values():
        assert c["right"] + c["wrong"] + c["none"] == inside
        assert c["outside: wrong"] + c["outside: none"] == 300 - inside
        assert c["at one pose"].estimate <= c["wrong of outside"].estimate
    for asked in range(4, 10):
        assert all(found[asked - 1][name] >= found[asked][name] for name in ("right", "wrong", "outside: wrong"))
    assert found[ACCEPTED]["asked"] == "rule" and found[4]["asked"] == ">= 4"
    assert found[ACCEPTED]["right"] == sum(r["accepted"] and r["inside"] and r["right"] for r in rows)
    assert found[6]["wrong"] == sum(r["pairings"] >= 6 and r["inside"] and not r["right"] for r in rows)


def test_answers_are_counted_by_their_pairings_and_their_rivals():
    columns = {
        "inside": [1, 1, 1, 1, 0, 0, 0, 0],
        "pairings": [4, 4, 3, 0, 3, 3, 2, 0],
        "right": [1, 0, 1, 0, 0, 0, 0, 0],
        "ambiguous": [0, 0, 0, 0, 0, 1, 0, 0],
        "accepted": [1, 1, 0, 0, 1, 0, 0, 0],
    }
    rows = [dict(zip(columns, row)) for row in zip(*columns.values())]
    names = ("right", "wrong", "none", "outside: wrong", "outside: none")
    counts = {asked: count_answers(rows, asked) for asked in (ACCEPTED, 2, 3, 4)}
    found = {asked: (*(c[n] for n in names), round(4 * c["at one pose"].estimate)) for asked, c in counts.items()}
    assert found[ACCEPTED] == (1, 1, 2, 1, 3, 1)
    assert found[2] == (2, 1, 1, 3, 1, 2)
    assert found[3] == (2, 1, 1, 2, 2, 1)
    assert found[4] == (1, 1, 2, 0, 4, 0)


def test_intervals_of_proportions_cover_them():
    assert (proportion(0, 300).low, proportion(0, 300).high) == (0.0, 0.01)
    assert proportion(5, 5).high == 1.0 and np.isnan(proportion(0, 0).estimate)
    rng, covered = np.random.default_rng(0), 0
    for _ in range(400):
        interval = proportion(int(rng.binomial(40, 0.2)), 40)
        covered += interval.low <= 0.2 <= interval.high
    assert covered >= 0.94 * 400


def test_an_attempt_records_the_answer_and_its_effort():
    scan = Scan.from_points(np.zeros((3, 2)), sigma=0.1)
    landmarks = Landmarks.from_points(np.zeros((4, 2)), sigma=0.1)
    effort = Effort(nodes=7, unary_tests=5, binary_tests=6, joint_tests=2, leaves=1)
    given = []

    def search(*arguments):
        given.extend(arguments)
        return Relocation(np.array([0, -1, 2]), np.zeros(3), np.eye(3), 1.0, 1, 2, False, 0, effort)

    answer, record = attempt(search, scan, landmarks, None)
    assert given == [scan, landmarks, None] and answer.pairings == 2
    expected = {"measurements": 3, "pairings": 2, "min pairings": 2, "accepted": True, "nodes": 7, "pairing tests": 11}
    assert expected.items() <= record.items() and record["hypotheses"] == 1 and record["ms"] > 0.0


def test_without_sizes_nothing_else_is_forgotten():
    for of in (Scan, Landmarks):
        given = of.from_points(np.arange(6.0).reshape(3, 2), sigma=0.1, sizes=[1.0, 2.0, 3.0], size_sigma=0.1)
        bare = without_sizes(given)
        assert np.isnan(bare.sizes).all() and np.isnan(bare.size_variances).all()
        np.testing.assert_array_equal(bare.covariances, given.covariances)
        np.testing.assert_array_equal(bare.points if of is Scan else bare.positions, np.arange(6.0).reshape(3, 2))
