"""Estimators on one log: consistent where they should be, found out where they are not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slam_gym.bench.consistency.estimators import METHODS, PoseEstimate, estimate, pose_figures, true_duplicates
from slam_gym.bench.consistency.logs import LoopSpec, hall, loop
from slam_gym.types import SPURIOUS, Odometry

SHORT = LoopSpec(heading=1.0, side=12, spacing=4.0)


def record_of(*arguments):
    return estimate(*arguments).record


def test_the_same_seed_gives_the_same_log_and_the_same_result():
    first, second = (record_of(loop(3, SHORT), "local maps", "jcbb") for _ in range(2))
    assert {**first, "seconds": 0.0} == {**second, "seconds": 0.0}


@pytest.mark.parametrize("method", METHODS)
def test_with_little_noise_every_estimator_is_consistent(method):
    quiet = replace(SHORT, heading=0.1, along=0.01)
    records = [record_of(loop(seed, quiet), method, "true_association") for seed in range(12)]
    assert all(r["duplicates"] == 0 and r["final [m]"] < 0.3 and r["map RMSE [m]"] < 0.3 for r in records)
    assert 0.5 < np.mean([r["ANEES"] for r in records]) < 1.6


@pytest.mark.parametrize("method", METHODS)
def test_a_filter_that_is_told_too_little_noise_is_found_out(method):
    log = loop(0, SHORT)
    told = [(Odometry(o.motion, 0.01 * o.covariance), s, t) for o, s, t in log.steps]
    honest, lied = (record_of(each, method, "true_association") for each in (log, replace(log, steps=told)))
    assert lied["ANEES"] > 3.0 > honest["ANEES"] and lied["optimistic"] > honest["optimistic"]


def test_the_truth_joins_each_source_once():
    sources = np.array([5, 5, 7, SPURIOUS, 9, 5, 7, 7, SPURIOUS, 11])
    identities = SimpleNamespace(source_of=lambda ids: sources[ids])
    joined = SimpleNamespace(ids=np.arange(10))
    found = true_duplicates(joined, np.arange(5), np.arange(5, 10), identities=identities)
    assert found.pairs.tolist() == [[0, 5], [2, 6]]
    nothing = true_duplicates(joined, np.arange(0), np.arange(10), identities=identities)
    assert nothing.pairs.shape == (0, 2)


def test_what_is_driven_does_not_depend_on_who_looks_at_it():
    log = hall(0, 60)
    assert len(log.steps) == 61
    before = [scan.points.copy() for _, scan, _ in log.steps]
    for method in METHODS:
        assert record_of(log, method, "jcbb")["error [m]"] < 0.3
    for points, (_, scan, _) in zip(before, log.steps):
        np.testing.assert_array_equal(points, scan.points)


def test_figures_of_poses():
    covariance = np.diag([0.04, 0.04, 0.01])
    truths = [np.array([1.0, 0.0, 3.1]), np.array([0.0, 0.0, -3.1])]
    estimates = [PoseEstimate(truth + off, covariance) for truth, off in zip(truths, ((0.3, 0.4, 0.0), (0, 0.2, 0.1)))]
    figures = pose_figures(estimates, truths)
    assert figures["error [m]"] == pytest.approx(np.sqrt((0.25 + 0.04) / 2)) and figures["final [m]"] == pytest.approx(
        0.2
    )
    assert figures["final [°]"] == pytest.approx(np.degrees(0.1)) and figures["heading σ [°]"] == pytest.approx(
        5.7296, abs=1e-3
    )
    assert (
        figures["ANEES"] == pytest.approx(((0.25 / 0.04) + (0.04 / 0.04 + 1.0)) / 2 / 3)
        and figures["optimistic"] == 0.0
    )
