"""NEES, NIS and whiteness at every level of drift: the short form of the benchmark, and its intervals."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.bench.consistency.innovations import LEVELS, at_level, innovations, ratio, row, run
from slam_gym.bench.report import Report
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.slam.slam import SlamSpec


@pytest.mark.parametrize("level", LEVELS)
def test_errors_and_innovations_are_as_large_as_predicted_and_innovations_white(level: int) -> None:
    """NIS per degree of freedom, free and in contact with walls, and the correlation with the innovation before.

    In contact they are as large as predicted, but not white: who leans on a wall slips the same way tick after tick.
    """
    found = [innovations(at_level(level, 200), world) for world in range(3)]
    (free, touching), dofs = sum(one.nis for one in found)
    assert 0.94 < free / dofs[0] < 1.06
    assert dofs[1] > 200 and 0.85 < touching / dofs[1] < 1.15
    products, counts = sum(one.lag for one in found)
    assert abs(products[0] / counts[0]) < 0.08
    assert level > 1 or products[1] / counts[1] > 0.1
    told = row(level, found)
    assert told["NIS, free"].low <= told["NIS, free"].estimate == free / dofs[0] <= told["NIS, free"].high
    assert 0.4 < told["NEES"].estimate < 2.0  # of three episodes, whose errors go on from tick to tick


def test_a_filter_that_takes_bends_for_straight_lines_is_found_out() -> None:
    """That of the papers, at the worst wheels: one pass, to first order."""
    papers = MapSpec(iterations=1, right_invariant=False, second_order=False, unconfirmed_age=5)
    scenario = replace(at_level(3, 150), slam=SlamSpec(papers, new_confidence=1.0 - 1e-6))
    found = row(3, [innovations(scenario, world) for world in range(3)])
    assert found["NIS, free"].low > 1.06


def test_ratios_of_sums_weigh_episodes_by_their_length() -> None:
    sums = np.array([[2.0, 1.0], [10.0, 10.0], [9.0, 10.0]])
    found = ratio(sums)
    assert found.estimate == 1.0 and 0.9 <= found.low < 1.0 < found.high <= 2.0
    assert np.isnan(ratio(np.zeros((3, 2))).estimate)


def test_the_benchmark_has_a_row_a_level(capsys) -> None:
    run(Report(), episodes=1, ticks=5)
    shown = capsys.readouterr().out
    assert "correlation, in contact" in shown and shown.count("level") >= 5
