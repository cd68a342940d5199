"""Maps are joined where one is recognised in the other, features that a map holds twice are found, and nothing else."""

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.geometry import observe, relative
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.linear_algebra import is_covariance
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.places.fusion import Fusion, MappedArea, find_duplicates, fuse, join_recognised, join_relocated
from slam_gym.slam.places.recognition import RecognitionSpec
from slam_gym.types import UNPAIRED, Array, IntArray, Scan
from tests.slam.rings import enter

SIGMA = 0.05
SPEC = RecognitionSpec()


def try_to_join(
    first: Array, second: Array, seed: int, *, back: bool = False
) -> tuple[Fusion | None, StochasticMap, StochasticMap]:
    """A map of the points `first`, and one of `second` as seen from a robot elsewhere, that begins at (30 m, 5 m). The
    second is active, or the first if the robot is `back` in it."""
    rng = np.random.default_rng((9, seed))
    a = StochasticMap(MapSpec(unconfirmed_age=None))
    graph_a, graph_b = CovisibilityGraph(), CovisibilityGraph()
    enter(a, graph_a, first, rng, SIGMA)
    b = a.successor()
    b.place(np.array([30.0, 5.0, 1.0]), np.zeros((3, 3)))
    enter(b, graph_b, second, rng, SIGMA)
    inactive, active = MappedArea(a, graph_a), MappedArea(b, graph_b)
    if back:
        inactive, active = active, inactive
    return join_recognised(inactive, active, np.arange(b.n), SPEC), a, b


def apart(rng: np.random.Generator, count: int) -> Array:
    """Points (count, 2) [m] in a square, no two nearer than .8 m."""
    points = np.empty((0, 2))
    while len(points) < count:
        drawn = rng.uniform(-6.0, 6.0, 2)
        if not len(points) or np.hypot(*(points - drawn).T).min() >= 0.8:
            points = np.concatenate([points, drawn[None]])
    return points


def test_the_robot_is_where_it_is_within_its_covariance_and_ids_and_graph_are_valid() -> None:
    distances = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        points, pose = apart(rng, 30), np.array([1.0, -2.0, 2.0])
        joined, a, b = try_to_join(points, observe(pose, points[:14]), seed)
        assert joined is not None, f"seed {seed}"
        m = joined.map
        np.testing.assert_array_equal(joined.ids[:, 0], joined.ids[:, 1] - 30)  # the right pairs, the older id first
        assert is_covariance(m.covariance) and joined.covisibility.n == m.n == a.n + b.n - len(joined.ids)
        assert len(np.unique(m.ids)) == m.n
        assert (a.n, b.n) == (30, 14) and not a.pose.any()  # neither map is changed
        kept = dict(joined.ids[:, ::-1].tolist())
        np.testing.assert_array_equal(m.ids[joined.became], [kept.get(number, number) for number in b.ids.tolist()])
        error = relative(pose, m.pose)
        distances.append(error @ np.linalg.solve(m.pose_covariance, error))
        assert np.hypot(*error[:2]) < 0.2 and abs(error[2]) < 0.05
    assert np.mean(distances) < 3.0 + 4.0 * np.sqrt(6.0 / len(distances))  # χ²₃, four standard errors of the mean


def test_maps_are_joined_in_the_base_of_the_one_that_began_first() -> None:
    points, pose = apart(np.random.default_rng(0), 30), np.array([1.0, -2.0, 2.0])
    joined, a, b = try_to_join(points, observe(pose, points[:14]), 0, back=True)
    assert joined is not None
    m = joined.map
    np.testing.assert_array_equal(m.ids[joined.became], a.ids)
    assert m.n == a.n and sorted(joined.ids[:, 1].tolist()) == b.ids.tolist()
    np.testing.assert_allclose(m.pose, a.pose, atol=1e-9)  # the robot has not moved
    assert np.hypot(*(m.positions - points).T).max() < 0.1 and is_covariance(m.covariance)


def test_features_stay_in_the_order_of_their_ids_when_a_map_that_began_in_between_is_joined_last() -> None:
    rng, base = np.random.default_rng(0), np.array([1.0, -2.0, 2.0])
    known, more, others = (apart(np.random.default_rng(seed), count) for seed, count in ((1, 30), (2, 6), (3, 10)))
    places = [known, np.concatenate([known[:14], more - 20.0]), np.concatenate([known[14:28], others + 20.0])]
    areas: list[MappedArea] = []
    for points in places:
        m = areas[-1].map.successor() if areas else StochasticMap(MapSpec(unconfirmed_age=None))
        areas.append(MappedArea(m, CovisibilityGraph()))
        enter(*areas[-1], observe(base, points) if m.next_id else points, rng, SIGMA)
    first = join_recognised(areas[0], areas[2], np.arange(14), SPEC)
    assert first is not None
    joined = join_recognised(areas[1], MappedArea(first.map, first.covisibility), np.arange(14), SPEC)
    assert joined is not None
    ids, truth = joined.map.ids, np.concatenate(places)
    assert (np.diff(ids) > 0).all() and np.isin(np.r_[:30, 44:50, 64:74], ids).all()
    assert np.hypot(*(joined.map.positions - truth[ids]).T).max() < 1.0
    seen_together = joined.covisibility.counts[: len(ids), : len(ids)] > 0
    np.fill_diagonal(seen_together, True)
    assert seen_together[ids < 30][:, ids < 30].all() and not seen_together[ids < 14][:, ids >= 64].any()


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
        there = observe(pose, points[:12])
        _, a, b = try_to_join(points, there, seed)
        graphs = [CovisibilityGraph(), CovisibilityGraph()]
        for graph, m in zip(graphs, (a, b)):
            graph.add(m.n)
        found = gcbb(Scan.from_points(there + rng.normal(0.0, SIGMA, there.shape), sigma=SIGMA), a.landmarks())
        assert found.accepted
        features = np.arange(12)
        features[2] = UNPAIRED  # what the scan did not update is no pair
        areas = MappedArea(a, graphs[0]), MappedArea(b, graphs[1])
        joined = join_relocated(*areas, found, features, SPEC)
        assert joined is not None and is_covariance(joined.map.covariance)
        np.testing.assert_array_equal(joined.ids[:, 0], joined.ids[:, 1] - 30)
        twice = np.where(np.arange(12) == 11, features[10], features)  # two measurements have updated one feature
        assert len(join_relocated(*areas, found, twice, SPEC).ids) == len(joined.ids) - 1
        few = np.where(np.arange(12) < 7, features, UNPAIRED)
        assert join_relocated(*areas, found, few, SPEC) is None
        error = relative(pose, joined.map.pose)
        assert np.hypot(*error[:2]) < 0.3 and abs(error[2]) < 0.08, f"seed {seed}"


@pytest.mark.parametrize("shared", [0, 4, 7])
def test_too_little_in_common_is_not_enough(shared: int) -> None:
    rng = np.random.default_rng(3)
    points = apart(rng, 30)
    there = np.concatenate([points[:shared], apart(rng, 14 - shared)])
    assert try_to_join(points, there, 3)[0] is None


def seen_as(rng: np.random.Generator, points: Array, scans: list[IntArray]) -> tuple[StochasticMap, CovisibilityGraph]:
    """A map of points (n, 2) by a robot that stands still, each of whose scans shows some of them."""
    m, graph = StochasticMap(MapSpec(unconfirmed_age=None)), CovisibilityGraph()
    enter(m, graph, points, rng, SIGMA, scans)
    return m, graph


def seen_in_turns(
    rng: np.random.Generator, common: int, one: Array, other: Array, scans: int = 10
) -> tuple[StochasticMap, CovisibilityGraph]:
    """Features around the robot; `one` (2,) is seen in the first scans, `other` (2,) in the others."""
    around = 3.0 * np.column_stack([np.cos(np.arange(common)), np.sin(np.arange(common))])
    early, late = np.delete(np.arange(common + 2), common + 1), np.delete(np.arange(common + 2), common)
    return seen_as(rng, np.concatenate([around, one[None], other[None]]), scans * [early] + scans * [late])


def test_a_feature_held_twice_is_found_and_the_older_comes_first() -> None:
    found = 0
    for seed in range(20):
        m, graph = seen_in_turns(np.random.default_rng(seed), 5, np.array([1.0, 1.0]), np.array([1.0, 1.0]))
        pairs = find_duplicates(m, graph, 5)
        assert len(pairs) <= 1
        found += pairs.tolist() == [[5, 6]]
    assert found >= 17  # of 20 at a confidence of .99


def test_two_features_side_by_side_are_left_alone() -> None:
    for seed in range(20):
        m, graph = seen_in_turns(np.random.default_rng(seed), 5, np.array([1.0, 1.0]), np.array([1.4, 1.0]))
        assert len(find_duplicates(m, graph, 5)) == 0


def test_what_one_scan_saw_as_two_is_two() -> None:
    m, graph = seen_in_turns(np.random.default_rng(0), 5, np.array([1.0, 1.0]), np.array([1.0, 1.0]))
    assert len(find_duplicates(m, graph, 5)) == 1
    graph.see_together(np.array([5, 6]))
    assert len(find_duplicates(m, graph, 5)) == 0


def test_too_few_neighbours_or_sightings_are_not_enough() -> None:
    for common, scans in ((2, 10), (5, 2)):
        m, graph = seen_in_turns(np.random.default_rng(0), common, np.array([1.0, 1.0]), np.array([1.0, 1.0]), scans)
        assert len(find_duplicates(m, graph, 5)) == 0


def test_a_third_feature_in_the_gate_leaves_it_open() -> None:
    m, graph = seen_in_turns(np.random.default_rng(0), 5, np.array([1.0, 1.0]), np.array([1.0, 1.0]))
    third = m.add(Scan.from_points([[1.0, 1.0]], sigma=SIGMA), np.array([0]))
    graph.add(1)
    for _ in range(4):
        m.end_of_step()
        m.update(Scan.from_points([[1.0, 1.0]], sigma=SIGMA), third)
    assert len(find_duplicates(m, graph, 10)) == 0


def test_a_rival_of_the_partner_leaves_it_open_too() -> None:
    """A third feature is in the gate of the second alone, and was not seen lately."""
    pairs = []
    for third in (1.2, 3.0):
        m, graph = seen_in_turns(np.random.default_rng(0), 5, np.array([1.0, 1.0]), np.array([1.05, 1.0]))
        far = m.add(Scan.from_points([[third, 1.0]], sigma=SIGMA), np.array([0]))
        graph.add(1)
        for _ in range(2):
            m.end_of_step()
            m.update(Scan.from_points([[third, 1.0]], sigma=SIGMA), far)
        pairs.append(find_duplicates(m, graph, 3).tolist())
    assert pairs == [[], [[5, 6]]]


def test_duplicates_that_were_not_seen_lately_wait() -> None:
    m, graph = seen_in_turns(np.random.default_rng(0), 5, np.array([1.0, 1.0]), np.array([1.0, 1.0]))
    for _ in range(10):
        m.end_of_step()
    assert len(find_duplicates(m, graph, 5)) == 0 and len(find_duplicates(m, graph, 30)) == 1


def seen_twice(rng: np.random.Generator, first: Array, second: Array) -> tuple[StochasticMap, CovisibilityGraph]:
    """The features `first` (a, 2), then, by scans that pair nothing of them, `second` (b, 2)."""
    a, every = len(first), np.arange(len(first) + len(second))
    return seen_as(rng, np.concatenate([first, second]), 10 * [every[:a]] + 10 * [every[a:]])


def test_a_place_mapped_twice_whole_is_found_where_six_pairs_stand_together() -> None:
    found = {6: 0, 5: 0}
    for count in found:
        around = 3.0 * np.column_stack([np.cos(np.arange(count)), np.sin(np.arange(count))])
        for seed in range(20):
            pairs = find_duplicates(*seen_twice(np.random.default_rng(seed), around, around), 5)
            np.testing.assert_array_equal(pairs[:, 1] - pairs[:, 0], count)
            found[count] += len(pairs)
    assert found[6] >= 0.8 * 6 * 20 and found[5] == 0


def test_other_features_at_the_same_place_are_left_alone() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        one, other = rng.uniform(-4.0, 4.0, (2, 12, 2))
        assert len(find_duplicates(*seen_twice(rng, one, other), 5)) == 0


def test_fusions_in_turn_are_one_fusion() -> None:
    """What the first has kept, the second may let go."""
    m, graph = StochasticMap(MapSpec(unconfirmed_age=None)), CovisibilityGraph()
    enter(m, graph, apart(np.random.default_rng(0), 6), np.random.default_rng(1), SIGMA)
    first = fuse(m, graph, np.array([[3, 5], [0, 1]]))
    second = fuse(first.map, first.covisibility, np.array([[1, 2]]))
    both = first.then(second)
    assert both.ids.tolist() == [[2, 5], [0, 1], [2, 3]] and both.map is second.map
    np.testing.assert_array_equal(both.became, [0, 0, 1, 1, 2, 1])
    np.testing.assert_array_equal(both.map.ids[both.became], [0, 0, 2, 2, 4, 2])
