"""A sequence of local maps: bases, ids, and the join of all of them."""

import numpy as np
import pytest

from slam_gym.geometry import compose, relative, transform
from slam_gym.mapping.local_maps import LocalMaps
from slam_gym.mapping.locality import locality_sizes, same_local_map
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import Array, IntArray
from tests.oracles.map import KnownAssociation, Step, wander

KEEP = MapSpec(unconfirmed_age=None)


class Run:
    """Known association into a new local map every so many steps."""

    def __init__(self, steps: list[Step], every: int) -> None:
        self.maps = LocalMaps(StochasticMap(KEEP))
        self.source: dict[int, int] = {}  # id -> landmark
        self.starts = [np.zeros(3)]  # true pose at the base of each map
        local = KnownAssociation(self.maps.current)
        for number, step in enumerate(steps):
            if number and number % every == 0:
                local = KnownAssociation(self.maps.begin())
                self.starts.append(steps[number - 1].pose)
            local.step(step)
            self.source.update(zip(self.maps.current.ids.tolist(), local.sources))
        self.asked: list[int] = []

    def match(self, joined: StochasticMap, older: int) -> IntArray:
        """The truth about a joined map."""
        self.asked.append(older)
        sources = [self.source[i] for i in joined.ids.tolist()]
        first = {source: j for j, source in enumerate(sources[:older])}
        pairs = [(first[s], older + j) for j, s in enumerate(sources[older:]) if s in first]
        return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def world(seed: int) -> tuple[Array, list[Step]]:
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform([-4.0, -2.0], [5.0, 7.0], (25, 2))
    return landmarks, list(wander(rng, 50, landmarks, reach=3.0))


def test_every_map_starts_certain_where_the_last_one_ended() -> None:
    _, steps = world(0)
    run = Run(steps, 10)
    assert len(run.maps) == 5
    for closed, base, start in zip(run.maps, run.maps.bases, run.starts):
        np.testing.assert_allclose(base, start, atol=0.3)
        assert closed.n > 0
    for number in range(1, 5):
        step = run.maps.bases[number], run.maps.bases[number - 1]
        np.testing.assert_allclose(relative(step[1], step[0]), run.maps[number - 1].pose, atol=1e-12)
    fresh = run.maps.begin()
    np.testing.assert_array_equal(fresh.pose, np.zeros(3))
    np.testing.assert_array_equal(fresh.pose_covariance, np.zeros((3, 3)))
    assert fresh.n == 0 and fresh.step == len(steps)
    np.testing.assert_allclose(run.maps.pose, run.maps.bases[-1], atol=1e-12)


def test_local_maps_are_right_in_their_own_base() -> None:
    """The uncertainty of a local map is small however far the robot has come; that is their point."""
    landmarks, steps = world(1)
    run = Run(steps, 10)
    for m, start in zip(run.maps, run.starts):
        true = np.array([landmarks[run.source[i]] for i in m.ids.tolist()])
        error = transform(start, m.positions) - true
        assert np.sqrt((error**2).mean()) < 0.15
        assert np.sqrt(np.linalg.eigvalsh(m.covariances).max()) < 0.3


def test_the_pose_is_that_of_the_joined_map_before_any_match() -> None:
    _, steps = world(2)
    run = Run(steps, 10)
    joined = run.maps.joined(lambda m, older: np.empty((0, 2), np.int64))
    np.testing.assert_allclose(joined.pose, run.maps.pose, atol=1e-9)
    assert joined.n == sum(m.n for m in run.maps)


def test_joining_leaves_each_landmark_once_under_its_oldest_id() -> None:
    landmarks, steps = world(3)
    run = Run(steps, 10)
    joined = run.maps.joined(run.match)
    sources = [run.source[i] for i in joined.ids.tolist()]
    assert len(set(sources)) == len(sources) == len(set(run.source.values()))
    oldest = {source: i for i, source in sorted(run.source.items(), reverse=True)}
    assert joined.ids.tolist() == sorted(oldest.values())
    given = sorted(run.source)
    assert run.maps.oldest(given).tolist() == [oldest[run.source[i]] for i in given]
    np.testing.assert_allclose(joined.positions, landmarks[sources], atol=0.4)
    np.testing.assert_allclose(joined.pose, steps[-1].pose, atol=0.3)
    assert joined.seen.sum() == sum(m.seen.sum() for m in run.maps)


def test_closed_maps_are_joined_once_and_the_current_one_anew() -> None:
    _, steps = world(4)
    run = Run(steps, 20)
    first = run.maps.joined(run.match)
    assert len(run.asked) == 2
    first.remove(np.arange(first.n))  # what was handed out is no window
    again = run.maps.joined(run.match)
    assert len(run.asked) == 3 and again.n > 0
    run.maps.begin()
    run.maps.joined(run.match)
    assert len(run.asked) == 5
    whole = Run(steps, 20)
    whole.maps.begin()
    np.testing.assert_array_equal(whole.maps.joined(whole.match).mean, run.maps.joined(run.match).mean)


def test_a_single_map_is_joined_as_it_is() -> None:
    _, steps = world(5)
    run = Run(steps, 100)
    np.testing.assert_array_equal(run.maps.joined(run.match).covariance, run.maps.current.covariance)
    assert not run.asked


def test_ids_tell_the_map_and_so_the_locality() -> None:
    _, steps = world(6)
    run = Run(steps, 10)
    for number, m in enumerate(run.maps):
        np.testing.assert_array_equal(run.maps.map_of(m.ids), np.full(m.n, number))
    joined = run.maps.joined(run.match)
    numbers = run.maps.map_of(joined.ids)
    sizes = locality_sizes(same_local_map(numbers), joined.n)
    np.testing.assert_array_equal(sizes, [int((numbers == k).sum()) for k in numbers])
    for ids in ([-1], [max(run.source) + 1]):
        with pytest.raises(ValueError, match="ids"):
            run.maps.map_of(ids)
    assert run.maps.map_of([]).shape == (0,)


def test_compose_of_bases_goes_around_the_circle() -> None:
    maps = LocalMaps(StochasticMap(KEEP, pose=[1.0, 0.0, 3.0]))
    maps.begin()
    maps.current.place([1.0, 0.0, 3.0], np.zeros((3, 3)))
    np.testing.assert_allclose(maps.pose, compose(np.array([1.0, 0, 3.0]), np.array([1.0, 0, 3.0])))
