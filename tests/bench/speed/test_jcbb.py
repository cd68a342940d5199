"""JCBB beside linear assignment."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from slam_gym.association import global_nearest_neighbour
from slam_gym.association.compatibility import chi2_gate, individual
from slam_gym.bench.runner import main
from slam_gym.bench.speed.jcbb import assignment_matrix, measure, summary
from slam_gym.bench.speed.loop_closure import CARRIED, closure_scan, mapped_field


@pytest.fixture(scope="module")
def scans():
    rng = np.random.default_rng(0)
    field = mapped_field(100, rng)
    return [closure_scan(field, 12, CARRIED, rng) for _ in range(8)]


def test_both_matrices_have_the_same_solution(scans):
    """That of global nearest neighbour, on the columns of all features as on those of the candidates alone."""
    for one in scans:
        candidates, gate = individual(one.scan, one.prediction), chi2_gate(2, 0.99)
        rows, n = candidates.rows[candidates.slots], len(one.prediction)
        dense = assignment_matrix(candidates, rows, n, gate)
        compact = assignment_matrix(candidates, candidates.slots, len(candidates.rows), gate)
        assert dense.shape == (12, n + 12) and compact.shape == (12, len(candidates.rows) + 12)
        prices = [matrix[linear_sum_assignment(matrix)].sum() for matrix in (dense, compact)]
        assert prices[0] == pytest.approx(prices[1])
        columns = linear_sum_assignment(dense)[1]
        decided = np.where(columns < n, one.prediction.features[np.minimum(columns, n - 1)], -1)
        answer = global_nearest_neighbour(one.scan, one.prediction).features
        assert answer.tolist() == decided.tolist()


def test_figures_are_of_the_answers(scans):
    figures = [measure(one) for one in scans]
    assert all(f["scans exact"] <= (f["right"] == 1.0) and f["candidates each"] > 0.5 for f in figures)
    row = summary(scans)
    assert row["scans exact"] == np.mean([f["scans exact"] for f in figures])
    assert row["nodes"] == np.median([f["nodes"] for f in figures]) and row["95 %"] >= row["JCBB"] > 0.0


def test_the_command_ends_with_a_tracking_scan(capsys):
    main(["jcbb", "--features", "60", "--problems", "2", "--measurements", "8"])
    *_, head, closure, sparse, tracking = capsys.readouterr().out.splitlines()
    assert head.startswith("workload") and closure.startswith("loop closure") and sparse.startswith("sparse")
    assert tracking.split()[:3] == ["tracking", "30", "12"]
