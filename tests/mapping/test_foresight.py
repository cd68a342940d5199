"""Motion and prediction in one call are motion, then prediction."""

import numpy as np
import pytest

from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import Odometry, Scan

MOVED = Odometry(np.array([0.3, 0.1, 0.2]), np.diag([1e-3, 2e-3, 3e-3]))


def mapped() -> tuple[StochasticMap, CovisibilityGraph]:
    rng, m, graph = np.random.default_rng(0), StochasticMap(), CovisibilityGraph()
    for _ in range(6):
        m.predict(MOVED)
        points = rng.uniform(-8.0, 8.0, (9, 2))
        graph.add(
            len(m.add(Scan.from_points(points, sigma=0.1, sizes=points[:, 0] ** 2, size_sigma=0.1), np.arange(9)))
        )
        graph.see_together(np.arange(m.n - 9, m.n))
        m.end_of_step()
    return m, graph


@pytest.mark.parametrize("locality", [True, False])
def test_both_in_one_call_are_one_after_the_other(locality: bool) -> None:
    (together, graph), (apart, _) = mapped(), mapped()
    recent, local = np.array([3, -1, 20, -1]), graph if locality else None
    one = together.prediction(5.0, local, recent, odometry=MOVED)
    apart.predict(MOVED)
    other = apart.prediction(5.0, local, recent[recent >= 0])
    assert 5 < len(one) < together.n
    for name in ("features", "positions", "covariances", "sizes", "kinds", "ages", "near", "heading_covariances"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(together.covariance, apart.covariance)
    assert one.near.all() != locality


def test_a_motion_that_is_refused_changes_nothing() -> None:
    m, graph = mapped()
    before = m.mean, m.covariance
    with pytest.raises(ValueError, match="odometry"):
        m.prediction(5.0, graph, odometry=Odometry(np.array([0.0, np.nan, 0.0]), np.zeros((3, 3))))
    np.testing.assert_array_equal(m.mean, before[0])
    np.testing.assert_array_equal(m.covariance, before[1])
