"""What a filter step costs: joint update of 10 pairings against one symmetric rank-20 product by BLAS, on one thread.

The product (dsyrk, on a matrix as large as the map's covariance) is the least that any dense EKF must do per update.
Both are timed in turns within one run, so that whatever else the machine does falls on both.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from scipy.linalg.blas import dsyrk
from threadpoolctl import threadpool_limits

from slam_gym.geometry import observe
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import Array, Odometry, Scan

PAIRINGS = 10
SIZES = (10, 30, 100, 300, 1000, 2000)
REACH = 6.0  # [m] of the sensor
STILL = Odometry(np.zeros(3), np.diag([1e-3, 1e-3, 1e-3]) ** 2)


def mapped(features: int, rng: np.random.Generator) -> StochasticMap:
    """A map of that many features at one per 6 m², all seen from one spot."""
    side = np.sqrt(6.0 * features)
    stochastic_map = StochasticMap(capacity=features)
    stochastic_map.predict(STILL)
    stochastic_map.add(_scan(rng.uniform(-side / 2, side / 2, (features, 2))), np.arange(features))
    return stochastic_map


def _scan(points: Array) -> Scan:
    m = len(points)
    return Scan(points, np.tile(0.03**2 * np.eye(2), (m, 1, 1)), np.full(m, 0.5), np.full(m, 0.05**2))


def _medians(timed: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Median time [µs] of each function, called in turns."""
    times: dict[str, list[float]] = {name: [] for name in timed}
    for _ in range(repeats + 2):
        for name, function in timed.items():
            start = time.perf_counter()
            function()
            times[name].append(time.perf_counter() - start)
    return {name: 1e6 * float(np.median(t[2:])) for name, t in times.items()}


def measure(features: int, repeats: int, rng: np.random.Generator) -> dict[str, float]:
    """Median times [µs] at one map size: predict, prediction, update, end of step, and `dsyrk`."""
    stochastic_map = mapped(features, rng)
    pairing = np.sort(rng.choice(features, PAIRINGS, replace=False))
    scan = _scan(observe(stochastic_map.pose, stochastic_map.positions[pairing]))
    d = 3 + 2 * features
    product, factor = np.zeros((d, d), order="F"), rng.normal(size=(2 * PAIRINGS, d)).T

    def end() -> None:
        stochastic_map.unconfirmed()
        stochastic_map.end_of_step()

    return _medians(
        {
            "predict": lambda: stochastic_map.predict(STILL),
            "prediction": lambda: stochastic_map.prediction(REACH),
            "update": lambda: stochastic_map.update(scan, pairing),
            "end": end,
            "dsyrk": lambda: dsyrk(-1.0, factor, beta=1.0, c=product, overwrite_c=True),
        },
        repeats,
    )


def main(argv: list[str] | None = None) -> None:
    """`python -m slam_gym.bench update`: print the table."""
    parser = argparse.ArgumentParser(prog="python -m slam_gym.bench update", description=__doc__)
    parser.add_argument("--features", type=int, nargs="+", default=SIZES, metavar="N", help="map sizes")
    parser.add_argument("--repeats", type=int, default=51, help="timed calls of each function")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    if min(arguments.features) < PAIRINGS or arguments.repeats < 1:
        parser.error(f"at least {PAIRINGS} features and 1 repeat")
    print(f"Joint update of {PAIRINGS} pairings; medians of {arguments.repeats} calls in turns [µs], one thread;")
    print("dsyrk: one symmetric rank-20 product of the covariance's size; ratio: update / dsyrk")
    print(f"{'features':>8} {'predict':>9} {'prediction':>11} {'update':>9} {'end':>6} {'dsyrk':>9} {'ratio':>6}")
    with threadpool_limits(1):
        for features in arguments.features:
            t = measure(features, arguments.repeats, np.random.default_rng(arguments.seed))
            print(
                f"{features:8d} {t['predict']:9.1f} {t['prediction']:11.1f} {t['update']:9.1f} {t['end']:6.1f} "
                f"{t['dsyrk']:9.1f} {t['update'] / t['dsyrk']:6.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
