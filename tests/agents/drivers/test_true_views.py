"""What is seen from where, and on the way: against the sight lines of the world itself."""

import numpy as np
import pytest

from agents.drivers.true_views import TrueViews, bits_of
from slam_gym.scenarios import get_scenario, world_generator
from slam_gym.simulation.episode import survey
from slam_gym.world.ray_casting import pull_back

SCENARIO = get_scenario("office-small")


def members(bits):
    """The features of a set, as Python has them."""
    return {64 * w + b for w, word in enumerate(bits.tolist()) for b in range(64) if word >> b & 1}


@pytest.fixture(scope="module")
def site():
    return survey(SCENARIO.generator(world_generator("train", 0)), SCENARIO)


@pytest.fixture(scope="module")
def views(site):
    return TrueViews(site, SCENARIO.sensor.range)


def test_sets_of_features_keep_every_feature():
    chosen = np.random.default_rng(0).random(150) < 0.4
    assert members(bits_of(chosen)) == set(np.flatnonzero(chosen))


def test_from_a_cell_is_seen_what_counts_is_near_and_no_wall_hides(site, views):
    features = site.plan.features
    for cell in np.random.default_rng(0).choice(len(site.cells), 20, replace=False):
        gaps = np.hypot(*(features.positions - site.cells[cell]).T)
        free = site.index.visible(site.cells[cell], features.positions, pull_back(features))
        expected = np.flatnonzero((gaps <= 0.95 * SCENARIO.sensor.range) & free & site.observable)
        assert members(views.seen[cell]) == set(expected)


def test_ways_are_as_long_there_as_back_and_no_shorter_than_the_straight_line(views):
    ends = views.viewpoints
    lengths = views.ways.lengths[:, ends]
    straight = np.hypot(*(views.cells[ends][:, None] - views.cells[ends]).transpose(2, 0, 1))
    assert np.allclose(lengths, lengths.T) and np.isfinite(lengths).all()
    assert (lengths >= straight - 1e-9).all() and (lengths > straight + 1.0).any()  # round corners


def test_on_a_way_is_seen_what_is_seen_from_its_ends_and_from_between(views):
    ends, more = views.viewpoints, 0
    for i in range(0, len(ends), 7):
        for j in range(0, len(ends), 5):
            seen = members(views.ways.seen[i, ends[j]])
            both = members(views.seen[ends[i]] | views.seen[ends[j]])
            assert seen >= both
            more += len(seen - both)
    assert more > 0


def test_viewpoints_leave_no_place_far_from_all_and_are_fewer_where_asked(site, views):
    gaps = np.hypot(*(site.cells[:, None] - site.cells[views.viewpoints]).transpose(2, 0, 1))
    assert gaps.min(axis=1).max() <= 1.2
    assert views.nearest(site.cells[[3, 50]] + 0.01).tolist() == [3, 50]
