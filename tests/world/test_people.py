"""People: where they walk, what they keep clear of, how long they wait."""

import numpy as np
import pytest

from slam_gym.world.ray_casting import WallIndex
from tests.world.test_physics import TWO_ROOMS, plan_of, world_in


def test_people_walk_about_and_keep_clear_of_walls_furniture_and_each_other():
    world = world_in(TWO_ROOMS, 1, 1, people=5)
    index, angles = WallIndex(np.vstack([TWO_ROOMS.walls, world.furniture_segments])), np.linspace(-3, 3, 60)
    visited, previous = np.zeros(5), world.people
    for _ in range(600):
        motion = world.tick(0.0, 0.0)
        people = world.people
        steps = np.hypot(*(people - previous)[:, :2].T)
        visited, previous = visited + steps, people
        assert steps.max() <= 0.08 + 1e-9
        assert not motion.contact, "they do not walk into a robot that stands"
        for person in people:
            assert index.cast(person[:2], angles, 6.0).min() > 0.24
        gaps = np.hypot(*(people[:, None, :2] - people[None, :, :2]).T) + 9 * np.eye(5)
        assert gaps.min() > 0.5
    assert visited.min() > 3.0, "everybody gets somewhere"
    np.testing.assert_array_equal(world.pose, [1, 1, 0])


def test_the_body_in_the_space_is_where_the_person_is():
    """A robot that drives at a person stops at their edge."""
    plan = plan_of((0, 0, 12, 1.2))
    world = world_in(plan, 1, 0.6, people=1, person_speed=0.01)
    person = world.people[0]
    for _ in range(200):
        bearing = np.arctan2(*(person[:2] - world.pose[:2])[::-1]) - world.pose[2]
        motion = world.tick(1.0, np.clip(2 * bearing, -1, 1))
        person = world.people[0]
    assert motion.contact
    assert np.hypot(*(person[:2] - world.pose[:2])) == pytest.approx(0.45, abs=0.02)


def test_people_wait_for_a_robot_in_their_way_then_turn_back():
    """A corridor that the robot plugs: nobody gets past, nobody pushes."""
    plan = plan_of((0, 0, 16, 1.0))
    world = world_in(plan, 8, 0.5, people=2)
    side = np.sign(world.people[:, 0] - 8)
    nearest = np.inf
    for _ in range(900):
        assert not world.tick(0.0, 0.0).contact
        nearest = min(nearest, np.hypot(*(world.people[:, :2] - [8, 0.5]).T).min())
    np.testing.assert_array_equal(np.sign(world.people[:, 0] - 8), side)
    np.testing.assert_array_equal(world.pose, [8, 0.5, 0])
    assert nearest < 1.0, "somebody did come up to the robot"
