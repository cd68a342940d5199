"""Estimators on a square corridor driven round: consistent where they should be, found out where they are not."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.consistency import METHODS, LoopSpec, estimate, loop
from slam_gym import Odometry

SHORT = LoopSpec(heading=1.0, side=12, spacing=4.0)


@pytest.mark.parametrize("method", METHODS)
def test_with_little_noise_every_estimator_is_consistent(method: str) -> None:
    quiet, associator = SHORT._replace(heading=0.1, along=0.01), "jcbb"
    runs = [estimate(loop(seed, quiet), method, associator) for seed in range(12)]
    assert all(run["duplicates"] == 0 and run["final [m]"] < 0.3 for run in runs)
    assert 0.5 < np.mean([run["ANEES"] for run in runs]) < 1.6


@pytest.mark.parametrize("method", METHODS)
def test_a_filter_that_is_told_too_little_noise_is_found_out(method: str) -> None:
    log = loop(0, SHORT)
    told = [(Odometry(o.motion, 0.01 * o.covariance), scan, truth) for o, scan, truth in log.steps]
    honest, lied = (estimate(each, method, "jcbb")["ANEES"] for each in (log, replace(log, steps=told)))
    assert lied > 3.0 > honest
