"""Features held twice: what is fused, and what is left alone."""

import numpy as np

from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.twins import find_twins
from slam_gym.types import UNPAIRED, Array, Scan

SIGMA = 0.05


def seen_in_turns(
    rng: np.random.Generator, common: int, one: Array, other: Array, scans: int = 10
) -> tuple[StochasticMap, CovisibilityGraph]:
    """Features around a robot that stands still; `one` (2,) is seen in the first scans, `other` (2,) in the others."""
    around = 3.0 * np.column_stack([np.cos(np.arange(common)), np.sin(np.arange(common))])
    points = np.concatenate([around, one[None], other[None]])
    m, graph, features = (
        StochasticMap(MapSpec(unconfirmed_age=None)),
        CovisibilityGraph(),
        np.full(common + 2, UNPAIRED),
    )
    for turn in range(2 * scans):
        shown = np.append(np.arange(common), common + (turn >= scans))
        seen = Scan.from_points(points[shown] + rng.normal(0.0, SIGMA, (common + 1, 2)), sigma=SIGMA)
        m.update(seen, features[shown])
        new = np.flatnonzero(features[shown] == UNPAIRED)
        features[shown[new]] = m.add(seen, new)
        graph.add(len(new))
        graph.see_together(features[shown])
        m.end_of_step()
    return m, graph


def test_a_feature_held_twice_is_found_and_the_older_comes_first() -> None:
    found = 0
    for seed in range(20):
        m, graph = seen_in_turns(np.random.default_rng(seed), 5, np.array([1.0, 1.0]), np.array([1.0, 1.0]))
        pairs = find_twins(m, graph, 5)
        assert len(pairs) <= 1
        found += pairs.tolist() == [[5, 6]]
    assert found >= 17  # of 20 at a confidence of .99


def test_two_features_side_by_side_are_left_alone() -> None:
    for seed in range(20):
        m, graph = seen_in_turns(np.random.default_rng(seed), 5, np.array([1.0, 1.0]), np.array([1.4, 1.0]))
        assert len(find_twins(m, graph, 5)) == 0


def test_what_one_scan_saw_as_two_is_two() -> None:
    m, graph = seen_in_turns(np.random.default_rng(0), 5, np.array([1.0, 1.0]), np.array([1.0, 1.0]))
    assert len(find_twins(m, graph, 5)) == 1
    graph.see_together(np.array([5, 6]))
    assert len(find_twins(m, graph, 5)) == 0


def test_too_few_neighbours_or_sightings_are_not_enough() -> None:
    for common, scans in ((2, 10), (5, 2)):
        m, graph = seen_in_turns(np.random.default_rng(0), common, np.array([1.0, 1.0]), np.array([1.0, 1.0]), scans)
        assert len(find_twins(m, graph, 5)) == 0


def test_a_third_feature_in_the_gate_leaves_it_open() -> None:
    m, graph = seen_in_turns(np.random.default_rng(0), 5, np.array([1.0, 1.0]), np.array([1.0, 1.0]))
    third = m.add(Scan.from_points([[1.0, 1.0]], sigma=SIGMA), np.array([0]))
    graph.add(1)
    for _ in range(4):
        m.end_of_step()
        m.update(Scan.from_points([[1.0, 1.0]], sigma=SIGMA), third)
    assert len(find_twins(m, graph, 10)) == 0


def test_twins_that_were_not_seen_lately_wait() -> None:
    m, graph = seen_in_turns(np.random.default_rng(0), 5, np.array([1.0, 1.0]), np.array([1.0, 1.0]))
    for _ in range(10):
        m.end_of_step()
    assert len(find_twins(m, graph, 5)) == 0 and len(find_twins(m, graph, 30)) == 1


def test_an_empty_map_has_none() -> None:
    assert find_twins(StochasticMap(), CovisibilityGraph(), 10).shape == (0, 2)


def seen_twice(rng: np.random.Generator, first: Array, second: Array) -> tuple[StochasticMap, CovisibilityGraph]:
    """The features `first` (a, 2), then, by scans that pair nothing of them, `second` (b, 2)."""
    m, graph = StochasticMap(MapSpec(unconfirmed_age=None)), CovisibilityGraph()
    for points in (first, second):
        features = np.full(len(points), UNPAIRED)
        for _ in range(10):
            seen = Scan.from_points(points + rng.normal(0.0, SIGMA, points.shape), sigma=SIGMA)
            m.update(seen, features)
            new = np.flatnonzero(features == UNPAIRED)
            features[new] = m.add(seen, new)
            graph.add(len(new))
            graph.see_together(features)
            m.end_of_step()
    return m, graph


def test_a_place_mapped_twice_whole_is_found_where_six_pairs_stand_together() -> None:
    found = {6: 0, 5: 0}
    for count in found:
        around = 3.0 * np.column_stack([np.cos(np.arange(count)), np.sin(np.arange(count))])
        for seed in range(20):
            pairs = find_twins(*seen_twice(np.random.default_rng(seed), around, around), 5)
            np.testing.assert_array_equal(pairs[:, 1] - pairs[:, 0], count)
            found[count] += len(pairs)
    assert found[6] >= 0.8 * 6 * 20 and found[5] == 0


def test_other_features_at_the_same_place_are_left_alone() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        one, other = rng.uniform(-4.0, 4.0, (2, 12, 2))
        assert len(find_twins(*seen_twice(rng, one, other), 5)) == 0
