"""Kidnappings to relocate from: what is drawn is where it is said to be, and the truth about it is true."""

import copy
import functools
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.geometry import compose, transform
from slam_gym.scenarios import KidnappingSpec
from slam_gym.simulation.relocation_problems import KNOWN, MappedWorld, kidnap
from slam_gym.types import SPURIOUS, UNPAIRED
from tests.rollouts import differences, short

SCENARIO = short(150)


@functools.cache
def mapped(world: int = 0) -> MappedWorld:
    return MappedWorld(SCENARIO, "train", world, "jcbb")


def test_a_mapped_world_is_a_function_of_its_arguments() -> None:
    again = MappedWorld(SCENARIO, "train", 0, "jcbb")
    assert not differences(again.landmarks.positions, mapped().landmarks.positions)
    assert not differences(again.trail, mapped().trail)
    assert not differences(again.identities, mapped().identities)
    assert differences(mapped(1).trail, mapped().trail)
    kidnapping = MappedWorld(replace(SCENARIO, kidnapping=KidnappingSpec()), "train", 0, "jcbb")
    assert not differences(kidnapping.trail, mapped().trail)  # nobody is carried away while he maps
    with pytest.raises(ValueError, match="world -1 of split 'train'"):
        MappedWorld(SCENARIO, "train", -1, "jcbb")


def test_every_true_feature_is_behind_one_landmark_at_most_and_near_it() -> None:
    world = mapped()
    known = world.identities[world.identities != SPURIOUS]
    assert len(known) == len(np.unique(known)) > 10
    true = world.site.plan.features.positions[known]
    found = transform(world.base, world.landmarks.positions[world.identities != SPURIOUS])
    assert np.median(np.hypot(*(found - true).T)) < 0.15
    assert len(world.trail) == SCENARIO.budget + 1


def test_inside_the_robot_has_been_there_and_knows_what_it_sees() -> None:
    world, rng = mapped(), np.random.default_rng(0)
    headings = []
    for _ in range(15):
        drawn = kidnap(world, SCENARIO, True, rng)
        headings.append(drawn.true_pose[2])
        assert drawn.inside and np.hypot(*(world.trail[:, :2] - drawn.true_pose[:2]).T).min() == 0.0
        paired = np.flatnonzero(drawn.features != UNPAIRED)
        assert len(paired) >= KNOWN
        # the pose in the map puts what is measured onto the landmarks that it is of
        seen = transform(drawn.pose, drawn.scan.points[paired])
        assert np.hypot(*(seen - world.landmarks.positions[drawn.features[paired]]).T).max() < 0.5
        in_world = transform(drawn.true_pose, drawn.scan.points[paired])
        sources = world.identities[drawn.features[paired]]
        assert np.hypot(*(in_world - world.site.plan.features.positions[sources]).T).max() < 0.5
    assert np.ptp(headings) > 3.0
    drifted, drift = copy.copy(world), np.array([0.8, -0.5, 0.1])  # drift of the map is no error of the answer
    drifted.landmarks = replace(world.landmarks, positions=transform(drift, world.landmarks.positions))
    sound, far = (kidnap(each, SCENARIO, True, np.random.default_rng(1)).pose for each in (world, drifted))
    np.testing.assert_allclose(far, compose(drift, sound))


def test_outside_is_another_world_where_nothing_is_known() -> None:
    world, rng = mapped(), np.random.default_rng(2)
    for _ in range(5):
        drawn = kidnap(world, SCENARIO, False, rng)
        assert not drawn.inside and len(drawn.scan) >= KNOWN
        assert (drawn.features == UNPAIRED).all() and np.isnan(drawn.pose).all()
        clear = world.elsewhere.cells
        assert np.hypot(*(clear - drawn.true_pose[:2]).T).min() < 0.2


def test_where_there_is_one_world_only_there_is_no_outside() -> None:
    alone = copy.copy(mapped())
    alone.elsewhere = None
    with pytest.raises(ValueError, match="has one world only"):
        kidnap(alone, SCENARIO, False, np.random.default_rng(0))
