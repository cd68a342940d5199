"""Maps of small random worlds beside their textbook twins, for the tests of this room."""

import numpy as np

from slam_gym.association.prediction import Prediction, predict
from slam_gym.geometry import observe
from slam_gym.mapping import ekf
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import Array, IntArray, Odometry
from tests.oracles.map import KnownAssociation, TextbookMap, wander

KEEP = MapSpec(iterations=1, right_invariant=False, second_order=False, unconfirmed_age=None)  # the textbook filter
START = np.array([1.0, -2.0, 3.0])
START_COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.03, -0.001], [0.002, -0.001, 0.01]])
STILL = Odometry(np.zeros(3), np.zeros((3, 3)))


def landmarks(rng: np.random.Generator, n: int = 25) -> Array:
    return rng.uniform([-4.0, -2.0], [5.0, 7.0], (n, 2))


def mapped(spec: MapSpec = KEEP, steps: int = 30, seed: int = 0) -> tuple[StochasticMap, TextbookMap, list[int]]:
    """A map that has seen a random world for a while, with its textbook twin and the landmark behind each feature."""
    rng = np.random.default_rng(seed)
    twins = KnownAssociation(
        StochasticMap(spec, START, START_COVARIANCE, capacity=2),
        TextbookMap(START, START_COVARIANCE),
    )
    for step in wander(rng, steps, landmarks(rng)):
        twins.step(step)
    assert twins.textbook is not None
    return twins.map, twins.textbook, twins.sources


def predicted(
    m: StochasticMap,
    reach: float = 100.0,
    graph: CovisibilityGraph | None = None,
    recent: IntArray | None = None,
    odometry: Odometry | None = None,
) -> Prediction:
    if recent is not None:
        m.arrays[2][ekf.LAST_SEEN, recent] = m.step
    return predict(m, reach, odometry=odometry, graph=graph, since=m.step)


def smallest_over_largest(m: StochasticMap) -> float:
    """Of the eigenvalues of its covariance, which is symmetric."""
    assert np.array_equal(m.covariance, m.covariance.T)
    eigenvalues = np.linalg.eigvalsh(m.covariance)
    return float(eigenvalues[0] / eigenvalues[-1])


def h(x: Array, features: Array) -> Array:
    return observe(x[:3], x[3:].reshape(-1, 2)[features]).ravel()
