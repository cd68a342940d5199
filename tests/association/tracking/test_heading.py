"""D² at the best heading: against a search of all headings."""

import numpy as np
import pytest

from slam_gym.association.tracking.heading import least_distance


@pytest.mark.parametrize("seed", range(40))
def test_the_least_distance_is_that_of_the_best_heading_nearby(seed):
    rng = np.random.default_rng(seed)
    errors = rng.standard_normal((6, 4)) * [0.3, 2.0, 2.0, 2.0]
    errors[:, 3] = errors[:, 2] + 0.3 * rng.standard_normal(6)  # a turn is explained by its linear part, nearly
    G, variance = errors.T @ errors, float(rng.uniform(0.01, 0.1))
    phi = np.linspace(-1.0, 1.0, 200_001)
    q = np.stack([np.ones_like(phi), np.cos(phi) - 1.0, np.sin(phi), -phi])
    cost = phi**2 / variance + (q * (G @ q)).sum(axis=0)
    found = least_distance(G, variance, 0.0)
    assert found.distance == pytest.approx(cost.min(), rel=1e-6)
    assert found.heading == pytest.approx(phi[cost.argmin()], abs=1e-4)
