"""Two maps, the way between which is unknown: joined where one is recognised in the other, and only there."""

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.geometry import relative
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.linear_algebra import is_covariance
from slam_gym.mapping.map_state import successor
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.loops import LoopSpec
from slam_gym.slam.recognition import Joined, join_recognised, join_relocated
from slam_gym.types import UNPAIRED, Array, Scan
from tests.slam.rings import enter

SIGMA = 0.05
SPEC = LoopSpec()


def try_to_join(first: Array, second: Array, seed: int) -> tuple[Joined | None, StochasticMap, StochasticMap]:
    """A map of the points `first`, and one of `second` as seen from a robot elsewhere, that begins at (30 m, 5 m)."""
    rng = np.random.default_rng((9, seed))
    a = StochasticMap(MapSpec(unconfirmed_age=None))
    graph_a, graph_b = CovisibilityGraph(), CovisibilityGraph()
    enter(a, graph_a, first, rng, SIGMA)
    b = successor(a)
    b.place(np.array([30.0, 5.0, 1.0]), np.zeros((3, 3)))
    enter(b, graph_b, second, rng, SIGMA)
    return join_recognised(a, graph_a, b, graph_b, np.arange(b.n), SPEC), a, b


def apart(rng: np.random.Generator, count: int) -> Array:
    """Points (count, 2) [m] in a square, no two nearer than .8 m."""
    points = np.empty((0, 2))
    while len(points) < count:
        drawn = rng.uniform(-6.0, 6.0, 2)
        if not len(points) or np.hypot(*(points - drawn).T).min() >= 0.8:
            points = np.concatenate([points, drawn[None]])
    return points


def seen_from(pose: Array, points: Array) -> Array:
    return np.array([relative(pose, np.array([*point, 0.0]))[:2] for point in points])


def test_the_robot_is_where_it_is_within_its_covariance_and_ids_and_graph_are_valid() -> None:
    distances = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        points, pose = apart(rng, 30), np.array([1.0, -2.0, 2.0])
        joined, a, b = try_to_join(points, seen_from(pose, points[:14]), seed)
        assert joined is not None, f"seed {seed}"
        m = joined.map
        np.testing.assert_array_equal(joined.ids[:, 0], joined.ids[:, 1] - 30)  # the right pairs, the older id first
        assert is_covariance(m.covariance) and joined.covisibility.n == m.n == a.n + b.n - len(joined.ids)
        assert len(np.unique(m.ids)) == m.n
        np.testing.assert_array_equal(m.ids[joined.became[: a.n]], a.ids)
        error = relative(pose, m.pose)
        distances.append(error @ np.linalg.solve(m.pose_covariance, error))
        assert np.hypot(*error[:2]) < 0.2 and abs(error[2]) < 0.05
    assert np.mean(distances) < 3.0 + 4.0 * np.sqrt(6.0 / len(distances))  # χ²₃, four standard errors of the mean


def test_neither_map_is_changed() -> None:
    points = apart(np.random.default_rng(1), 30)
    joined, a, b = try_to_join(points, seen_from(np.array([1.0, 0.0, 1.0]), points[:14]), 1)
    assert joined is not None and a.n == 30 and b.n == 14
    np.testing.assert_array_equal(a.pose, np.zeros(3))
    np.testing.assert_allclose(b.pose, [30.0, 5.0, 1.0])


def test_other_ground_and_mirror_images_are_not_recognised() -> None:
    wrong = 0
    for seed in range(25):
        rng = np.random.default_rng((2, seed))
        points = apart(rng, 30)
        for elsewhere in (apart(rng, 14), points[:14] * np.array([1.0, -1.0])):
            wrong += try_to_join(points, elsewhere, seed)[0] is not None
    assert wrong == 0  # of 50: bounds the rate by 6 % at 95 %


def test_a_scan_that_is_found_in_the_older_map_joins_them_too() -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        points, pose = apart(rng, 30), np.array([1.0, -2.0, 2.0])
        there = seen_from(pose, points[:12])
        _, a, b = try_to_join(points, there, seed)
        graphs = [CovisibilityGraph(), CovisibilityGraph()]
        for graph, m in zip(graphs, (a, b)):
            graph.add(m.n)
        found = gcbb(Scan.from_points(there + rng.normal(0.0, SIGMA, there.shape), sigma=SIGMA), a.landmarks())
        assert found.accepted
        features = np.arange(12)
        features[2] = UNPAIRED  # what the scan did not update is no pair
        joined = join_relocated(a, graphs[0], b, graphs[1], found, features, SPEC)
        assert joined is not None and is_covariance(joined.map.covariance)
        np.testing.assert_array_equal(joined.ids[:, 0], joined.ids[:, 1] - 30)
        few = np.where(np.arange(12) < 7, features, UNPAIRED)
        assert join_relocated(a, graphs[0], b, graphs[1], found, few, SPEC) is None
        error = relative(pose, joined.map.pose)
        assert np.hypot(*error[:2]) < 0.3 and abs(error[2]) < 0.08, f"seed {seed}"


@pytest.mark.parametrize("shared", [0, 4, 7])
def test_too_little_in_common_is_not_enough(shared: int) -> None:
    rng = np.random.default_rng(3)
    points = apart(rng, 30)
    there = np.concatenate([points[:shared], apart(rng, 14 - shared)])
    assert try_to_join(points, there, 3)[0] is None
