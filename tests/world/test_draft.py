"""What a draft makes of rooms: doors with their jambs, furniture at its distance."""

import numpy as np
import pytest

from slam_gym.world import boxes
from slam_gym.world.floor_plan import Kind
from tests.world.test_generators import CASES, draw


@pytest.mark.parametrize(("generator", "seed"), CASES)
def test_each_door_has_four_jambs_of_its_width(generator, seed):
    plan = draw(generator, seed)
    features = plan.features
    jamb = features.kinds == Kind.DOOR_JAMB
    assert jamb.sum() == 4 * len(plan.doors)
    for door in plan.doors:
        assert 0.9 <= door.width <= 1.3
        near = np.hypot(*(features.positions - door.position).T) < 0.5 * door.width + 0.2
        assert near.sum() == 4 and jamb[near].all()
        np.testing.assert_allclose(features.sizes[near], door.width)


@pytest.mark.parametrize(("generator", "seed"), CASES)
def test_furniture_keeps_its_distance_from_doors_and_walls(generator, seed):
    plan = draw(generator, seed)
    for box in plan.furniture:
        for door in plan.doors:
            assert boxes.distance(*door.position, box[None]) > door.width / 2 + 0.5
        for position in plan.features.positions:
            assert boxes.distance(*position, box[None]) > 0.0
