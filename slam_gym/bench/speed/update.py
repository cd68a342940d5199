"""What a filter step costs: joint update of 10 pairings against one symmetric rank-20 product by BLAS, on one thread.

The product (dsyrk, on a matrix as large as the map's covariance) is the least that any dense EKF must do per update.
Both are timed in turns within one run, so that whatever else the machine does falls on both.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.blas import dsyrk

from slam_gym.bench.records import Record
from slam_gym.bench.report import Report
from slam_gym.bench.runner import UsageError
from slam_gym.bench.timing import medians_in_turns
from slam_gym.geometry import observe
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import Array, Odometry, Scan

PAIRINGS = 10
REACH = 6.0  # [m] of the sensor
STILL = Odometry.from_motion(np.zeros(3), 1e-3)


def mapped(features: int, rng: np.random.Generator) -> StochasticMap:
    """A map of that many features at one per 6 m², all seen from one spot."""
    side = np.sqrt(6.0 * features)
    stochastic_map = StochasticMap(capacity=features)
    stochastic_map.predict(STILL)
    stochastic_map.add(_scan(rng.uniform(-side / 2, side / 2, (features, 2))), np.arange(features))
    return stochastic_map


def _scan(points: Array) -> Scan:
    return Scan.from_points(points, sigma=0.03, sizes=np.full(len(points), 0.5), size_sigma=0.05)


def measure(features: int, repeats: int, rng: np.random.Generator) -> Record:
    """Median times [µs] at one map size."""
    stochastic_map = mapped(features, rng)
    pairing = np.sort(rng.choice(features, PAIRINGS, replace=False))
    scan = _scan(observe(stochastic_map.pose, stochastic_map.positions[pairing]))
    d = 3 + 2 * features
    product, factor = np.zeros((d, d), order="F"), rng.normal(size=(2 * PAIRINGS, d)).T

    def end(_: int) -> None:
        stochastic_map.unconfirmed()
        stochastic_map.end_of_step()

    calls = {
        "predict": lambda _: stochastic_map.predict(STILL),
        "prediction": lambda _: stochastic_map.prediction(REACH),
        "update": lambda _: stochastic_map.update(scan, pairing),
        "end of step": end,
        "dsyrk": lambda _: dsyrk(-1.0, factor, beta=1.0, c=product, overwrite_c=True),
    }
    times = medians_in_turns(calls, repeats, warm_up=2)
    return {"features": features, **times, "update / dsyrk": times["update"] / times["dsyrk"]}


def run(
    report: Report,
    *,
    features: tuple[int, ...] = (10, 30, 100, 300, 1000, 2000),
    repeats: int = 51,
    seed: int = 0,
) -> None:
    """One row for each size of the map.

    Arguments:
        features: map sizes
        repeats: timed calls of each function
        seed: of everything random
    """
    if min(features) < PAIRINGS or repeats < 1:
        raise UsageError(f"at least {PAIRINGS} features and 1 repeat")
    rows = [measure(n, repeats, np.random.default_rng(seed)) for n in features]
    report.table(f"Joint update of {PAIRINGS} pairings: medians of {repeats} calls in turns [µs]", rows, "update")
