"""The sparse assignment of points against the dense one."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from slam_gym.metrics.point_assignment import assign, indexed
from slam_gym.types import UNPAIRED
from tests.oracles.statistics import for_seeds


def dense_optimum(estimated, true, cutoff, p):
    """Textbook: every point of either set may also go to a dummy of its own, for half the cutoff."""
    e, n = len(estimated), len(true)
    cost = np.full((e + n, e + n), 0.5 * cutoff**p)
    cost[:e, :n] = np.linalg.norm(estimated[:, None] - true[None], axis=2) ** p
    cost[e:, n:] = 0.0
    return cost[linear_sum_assignment(cost)].sum()


@for_seeds(300)
def test_sparse_assignment_is_the_dense_optimum(seed):
    rng = np.random.default_rng(seed)
    cutoff, p = rng.choice([0.1, 1.0, 3.0, 30.0]), rng.choice([1.0, 1.5, 2.0])
    true = rng.uniform(-4, 4, (rng.integers(0, 40), 2)) * rng.choice([0.2, 1.0, 1.0, 5.0], size=2)
    copies = true[rng.integers(0, len(true), rng.integers(0, 40))] if len(true) else true
    estimated = np.vstack([copies + rng.normal(0, 0.5, copies.shape), rng.uniform(-5, 5, (rng.integers(0, 6), 2))])
    features, total, pairings = assign(estimated, indexed(true, cutoff), p)
    paired = features != UNPAIRED
    assert paired.sum() == pairings == len(set(features[paired].tolist()))
    distances = np.linalg.norm(estimated[paired] - true[features[paired]], axis=1)
    assert total == pytest.approx((distances**p).sum()) and (distances < cutoff).all()
    unpaired = len(estimated) + len(true) - 2 * pairings
    assert total + 0.5 * cutoff**p * unpaired == pytest.approx(dense_optimum(estimated, true, cutoff, p), abs=1e-9)
