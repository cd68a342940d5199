"""Where several maps are kept, explored space and the way are those of the map that is believed."""

import copy
import functools
import pickle

import numpy as np
from slam_gym.navigation.sweeps import MovableSweeps

from slam_gym.association import deferred
from slam_gym.envs.explore import ExploreEnv
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.simulation.belief import Belief
from slam_gym.types import Beams

NARROW = functools.partial(deferred, factor=20.0, apart=3.0)  # leaves much open


def test_a_copy_goes_its_own_way() -> None:
    grid = ExploredGrid(np.array([-5.0, -5.0, 5.0, 5.0]))
    belief = Belief(grid, MovableSweeps(grid), [np.zeros(3)], [1.0])
    other = belief.copy()
    beams, nobody = Beams(np.zeros(1), np.full(1, 3.0), 6.0), np.empty(0, np.int64)
    other.sweeps.enter(np.zeros(3), np.zeros(3), beams, nobody, Nothing())
    other.estimates.append(np.ones(3))
    assert (belief.grid.cells == 0).all() != (other.grid.cells == 0).all() or (
        (belief.grid.cells != other.grid.cells).any()
    )
    assert len(belief.estimates) == 1 and len(other.estimates) == 2


class Nothing:
    """A map without features."""

    ids = np.empty(0, np.int64)
    positions = np.empty((0, 2))


def driven(env, steps):
    """What becomes of an episode, and how often the map that is believed has changed."""
    env.reset(seed=0, options={"world": 0})
    several = changed = 0
    rng = np.random.default_rng(0)
    for _ in range(steps):
        before = env.episode.slam
        observation, *_ = env.step(rng.uniform([0.2, -1.0], 1.0).astype(np.float32))
        several += len(env.episode._judged.kept) > 1
        changed += env.episode.slam is not before
    return observation, several, changed


def test_an_episode_goes_on_with_all_that_belongs_to_the_map_it_believes() -> None:
    env = ExploreEnv("sparse", associator=NARROW, action="twist", overrides={"budget": 400})
    observation, several, changed = driven(env, 70)
    assert several > 10 and changed > 0
    episode = env.episode
    kept, beliefs = episode._judged.kept, episode._beliefs
    assert len(kept) == len(beliefs) and episode.slam is kept[0].slam and episode.grid is beliefs[0].grid
    for branch, belief in zip(kept, beliefs):
        assert len(belief.estimates) == len(belief.nees) == episode.ticks + 1 == len(episode.poses)
        np.testing.assert_allclose(belief.estimates[-1], branch.slam.map.pose)
        assert np.shares_memory(branch.slam.view_from.explored.cells, belief.grid.cells)
    assert episode.identities is episode._judged.identities and episode.identities.total.scans > 10
    twin = ExploreEnv("sparse", associator=NARROW, action="twist", overrides={"budget": 400})
    assert all(np.array_equal(observation[key], other) for key, other in driven(twin, 70)[0].items())
    for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert [b.log_weight for b in other.episode._judged.kept] == [b.log_weight for b in kept]
        np.testing.assert_array_equal(other.episode.slam.map.mean, episode.slam.map.mean)
        np.testing.assert_array_equal(other.episode.grid.cells, episode.grid.cells)
