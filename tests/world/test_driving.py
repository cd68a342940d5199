"""The closed form of a robot that touches nothing: what pymunk would have made of it, whatever comes after."""

import numpy as np
import pytest

from slam_gym.world.floor_plan import Features, FloorPlan, Room
from slam_gym.world.physics import DynamicsSpec, RobotSpec, World

CORNERS = [(0, 0), (12, 0), (12, 8), (0, 8)]
WALLS = [(*CORNERS[k], *CORNERS[(k + 1) % 4]) for k in range(4)] + [(6, 0, 6, 3.5), (6, 4.5, 6, 8)]
BOXES = [(3, 6, 1.2, 0.6, 0.3), (9, 2, 0.8, 0.8, 1.0), (4.2, 6.4, 0.5, 0.5, 0.0)]
NO_FEATURES = Features(np.empty((0, 2)), np.empty(0), np.empty(0))
TWO_ROOMS = FloorPlan("two rooms", WALLS, NO_FEATURES, (Room("both", CORNERS),), (), BOXES)


class ByPymunk(World):
    """Every tick goes to pymunk."""

    def _drive_freely(self, forward, turn, motion):
        return False


def action_of(rng, tick, heading):
    """Long drives in one direction, so that the robot runs into corners and furniture, and shakes there."""
    if tick % 12 == 0:
        heading[:] = rng.choice([1.0, 1.0, -1.0]) * rng.uniform(0.3, 1.0), rng.uniform(-0.6, 0.6)
    return np.clip(heading + rng.normal(0.0, 0.2, 2), -1.0, 1.0)


@pytest.mark.parametrize("seed", range(8))
def test_motion_between_contacts_and_in_them_is_that_of_pymunk(seed):
    rng, ticks, free = np.random.default_rng(seed), 1500, 0
    start, heading = np.array([2.0, 2.0, rng.uniform(-3.0, 3.0)]), np.zeros(2)
    worlds = [
        kind(TWO_ROOMS, start, RobotSpec(), DynamicsSpec(), np.random.default_rng(0)) for kind in (World, ByPymunk)
    ]
    for tick in range(ticks):
        if tick == 700:
            for world in worlds:
                world.place(start)
        action = action_of(rng, tick, heading)
        ours, theirs = (world.tick(*action) for world in worlds)
        np.testing.assert_allclose(worlds[0].pose, worlds[1].pose, rtol=0, atol=1e-12)
        np.testing.assert_allclose(ours.moved, theirs.moved, rtol=0, atol=1e-12)
        np.testing.assert_allclose(ours.wheels, theirs.wheels, rtol=0, atol=1e-12)
        np.testing.assert_allclose(worlds[0].furniture, worlds[1].furniture, rtol=0, atol=1e-12)
        assert ours.contact == theirs.contact
        free += not worlds[0]._body_knows
    assert 0.3 * ticks < free < 0.97 * ticks, "both ways were taken"


def test_in_the_open_pymunk_is_not_asked(monkeypatch):
    world = World(TWO_ROOMS, np.array([1.0, 1.0, 0.3]), RobotSpec(), DynamicsSpec(), np.random.default_rng(0))
    monkeypatch.setattr(world, "_space", None)
    for _ in range(20):
        world.tick(1.0, 0.3)
    assert world.pose[0] > 2.0
