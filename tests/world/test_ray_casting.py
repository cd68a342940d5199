"""Line of sight against pymunk's segment queries, against brute force, and against geometry that is known."""

import numpy as np
import pymunk
import pytest

from slam_gym.world.floor_plan import Features, Kind
from slam_gym.world.ray_casting import NOTHING, box_distance, cast, outlines, pull_back, seen_from, wall_index

ROOM = np.array([[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]], float)


def random_walls(rng, count=120, side=15.0):
    start = rng.uniform(0, side, (count, 2))
    return np.hstack([start, start + rng.normal(scale=1.5, size=(count, 2))])


def pymunk_ranges(walls, discs, origin, angles, max_range):
    space = pymunk.Space()
    for x1, y1, x2, y2 in walls.tolist():
        space.add(pymunk.Segment(space.static_body, (x1, y1), (x2, y2), 0.0))
    for x, y, radius in discs.tolist():
        space.add(pymunk.Circle(space.static_body, radius, (x, y)))
    ranges = []
    for angle in angles:
        end = origin + max_range * np.array([np.cos(angle), np.sin(angle)])
        hit = space.segment_query_first(tuple(origin), tuple(end), 0.0, pymunk.ShapeFilter())
        ranges.append(max_range * (hit.alpha if hit else 1.0))
    return np.array(ranges)


@pytest.mark.parametrize("seed", range(5))
def test_ranges_agree_with_pymunk(seed):
    rng = np.random.default_rng(seed)
    walls = random_walls(rng)
    index, angles = wall_index(walls), np.linspace(-np.pi, np.pi, 72)
    for origin in rng.uniform(-4, 19, (20, 2)):
        people = np.column_stack([rng.uniform(0, 15, (8, 2)), rng.uniform(0.1, 0.6, 8)])
        people = people[np.hypot(*(people[:, :2] - origin).T) > people[:, 2]]
        furniture = random_walls(rng, 10)
        expected = pymunk_ranges(np.vstack([walls, furniture]), people, origin, angles, 6.0)
        ranges = cast(index, origin, angles, 6.0, (people, furniture))
        np.testing.assert_allclose(ranges, expected, rtol=0, atol=1e-12)


def test_no_ray_leaves_a_closed_room_through_its_corners():
    rng = np.random.default_rng(3)
    turn = np.linspace(0, 2 * np.pi, 41)[:-1]
    outline = np.column_stack([5 * np.cos(turn), 5 * np.sin(turn)]) * rng.uniform(0.8, 1.2, (40, 1))
    index = wall_index(np.hstack([outline, np.roll(outline, -1, axis=0)]))
    for origin in rng.uniform(-2, 2, (50, 2)):
        angles = np.arctan2(*(outline - origin).T[::-1])
        assert cast(index, origin, angles, 50.0, NOTHING).max() < 10.0


def test_visible_is_what_the_ranges_say():
    rng = np.random.default_rng(11)
    walls, discs = random_walls(rng), np.column_stack([rng.uniform(0, 15, (5, 2)), np.full(5, 0.3)])
    index, moving = wall_index(walls), (discs, NOTHING[1])
    for origin in rng.uniform(0, 15, (20, 2)):
        targets = rng.uniform(0, 15, (40, 2))
        offsets = targets - origin
        distances, angles = np.hypot(*offsets.T), np.arctan2(*offsets.T[::-1])
        free = np.array(
            [cast(index, origin, angle[None], reach, moving)[0] for angle, reach in zip(angles, distances + 1e-9)]
        )
        seen = seen_from(index, origin[None], targets, np.zeros(40), np.inf, moving)
        np.testing.assert_array_equal(seen, free >= distances)


def test_features_are_seen_past_their_own_walls():
    """A corner where walls meet, and the centre of a pillar whose outline is in the walls."""
    turn = np.linspace(0, 2 * np.pi, 9)
    octagon = np.array([2.0, 1.5]) + 0.2 * np.column_stack([np.cos(turn), np.sin(turn)])
    index = wall_index(np.vstack([ROOM, np.hstack([octagon[:-1], octagon[1:]])]))
    features = Features(
        np.array([[0, 0], [4, 3], [2, 1.5]], float), [Kind.CORNER, Kind.DOOR_JAMB, Kind.PILLAR], [1, 1, 0.4]
    )
    back = pull_back(features)
    assert back[0] == back[1] < 0.01 and back[2] == pytest.approx(0.2, abs=0.01)
    for origin, second in (([0.5, 2.5], True), ([3.5, 0.5], True), ([2.5, 2.6], True), ([1.0, 0.75], False)):
        seen = seen_from(index, np.array([origin]), features.positions, back, np.inf, NOTHING)
        np.testing.assert_array_equal(seen, [True, second, True])  # the pillar hides the corner behind it


@pytest.mark.parametrize("cell", [0.11, 0.7, 3.0, 100.0])
def test_size_of_the_cells_does_not_matter(cell):
    rng = np.random.default_rng(7)
    walls = np.vstack([random_walls(rng), np.round(random_walls(rng) / cell) * cell])  # many along cell borders
    one_by_one, index = wall_index(np.zeros((1, 4))), wall_index(walls, cell)
    angles = np.concatenate([rng.uniform(-np.pi, np.pi, 60), np.arange(8) * np.pi / 4])
    for origin in np.vstack([rng.uniform(-3, 18, (30, 2)), np.round(rng.uniform(0, 15, (30, 2)) / cell) * cell]):
        brute_force = cast(one_by_one, origin, angles, 9.0, (NOTHING[0], walls))
        np.testing.assert_allclose(cast(index, origin, angles, 9.0, NOTHING), brute_force, rtol=0, atol=1e-12)


def test_box_outlines_and_distances():
    box = np.array([[1.0, 2.0, 4.0, 2.0, np.pi / 2]])
    corners = {tuple(np.round(side[:2], 9)) for side in outlines(box)}
    assert corners == {(0.0, 0.0), (2.0, 0.0), (2.0, 4.0), (0.0, 4.0)}
    sides = outlines(box)
    np.testing.assert_allclose(sides[:, 2:], np.roll(sides[:, :2], -1, axis=0))
    area = 0.5 * np.sum(sides[:, 0] * sides[:, 3] - sides[:, 2] * sides[:, 1])
    assert area == pytest.approx(8.0), "counter-clockwise"
    for point, distance in (((1, 2), 0), ((3, 2), 1), ((1, -1), 1), ((5, 8), 5)):
        assert box_distance(*map(float, point), box) == pytest.approx(distance, abs=1e-12)
    assert box_distance(0.0, 0.0, np.empty((0, 5))) == np.inf


@pytest.mark.parametrize(
    ("walls", "cell", "message"),
    [
        (np.zeros((3, 3)), 1.0, r"shape \(s, 4\)"),
        (np.array([[0, 0, 1, 1], [0, np.nan, 1, 1]]), 1.0, r"walls\[1\] is not finite"),
        (ROOM, 0.0, "cell must be a positive length"),
        (ROOM, np.nan, "cell must be a positive length"),
    ],
)
def test_bad_walls_are_refused_by_name(walls, cell, message):
    with pytest.raises(ValueError, match=message):
        wall_index(walls, cell)
