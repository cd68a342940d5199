"""Generated plans: reproducible, connected, full of features, and furnished without blocking anything."""

import dataclasses

import numpy as np
import pytest

from slam_gym.world.draft import Contents, outline
from slam_gym.world.floor_plan import Kind
from slam_gym.world.generators import AliasedGenerator, HallGenerator, LoopGenerator, OfficeGenerator
from slam_gym.world.ray_casting import outlines, wall_index
from slam_gym.world.reachability import free_cells, observable, reachable
from tests.oracles.statistics import for_seeds

RADIUS = 0.2  # [m] of the robot
CROWDED = Contents(pilasters=0.3, pillars=4.0, furniture=6.0)
GENERATORS = {
    "office": OfficeGenerator(),
    "office-small": OfficeGenerator(rooms=4),
    "office-crowded": OfficeGenerator(contents=CROWDED),
    "one room": OfficeGenerator(rooms=1),
    "aliased": AliasedGenerator(),
    "aliased-crowded": AliasedGenerator(contents=CROWDED),
    "hall": HallGenerator(),
    "loop": LoopGenerator(),
    "loop-crowded": LoopGenerator(contents=CROWDED),
    "loop-deep": LoopGenerator(contents=Contents(pilasters=0.3, pilaster_depth=(1.0, 2.0))),
    "hall-crowded": HallGenerator(contents=Contents(pilasters=0.5, pillars=120.0, furniture=30.0)),
}
every_generator = pytest.mark.parametrize("generator", GENERATORS.values(), ids=GENERATORS)


def draw(generator, seed=0):
    return generator(np.random.default_rng(seed))


@every_generator
def test_every_room_can_be_driven_to_around_the_furniture(generator):
    plan = draw(generator)
    obstructed = dataclasses.replace(plan, walls=np.vstack([plan.walls, outlines(plan.furniture)]))
    cells = reachable(obstructed, free_cells(obstructed, RADIUS, 0.1))
    for room in plan.rooms:
        assert np.hypot(*(cells - room.polygon.mean(axis=0)).T).min() < 0.15, room.name
    for door in plan.doors:
        assert np.hypot(*(cells - door.position).T).min() < 0.15


@every_generator
def test_features_sit_on_the_walls_and_can_be_seen(generator):
    plan = draw(generator)
    features = plan.features
    pillar = features.kinds == Kind.PILLAR
    ends = plan.walls.reshape(-1, 2)
    for position in features.positions[~pillar]:
        assert np.count_nonzero((ends == position).all(axis=1)) == 2
    for position, size in zip(features.positions[pillar], features.sizes[pillar]):
        on_it = np.isclose(np.hypot(*(ends - position).T), size / 2, atol=1e-9)
        assert np.count_nonzero(on_it) == 16  # the two ends of each side of an octagon
    assert observable(plan, wall_index(plan.walls), reachable(plan, free_cells(plan, RADIUS)), 6.0).all()


@pytest.mark.parametrize("seed", range(8, 16))
def test_aliased_rooms_are_identical_and_equally_spaced(seed):
    plan = draw(AliasedGenerator(), seed)
    rooms = [room for room in plan.rooms if room.name != "corridor"]
    assert len(rooms) >= 8
    corridor = plan.rooms[0].polygon[:, 1].max()
    views = []
    positions = np.vstack([plan.features.positions, outlines(plan.furniture)[:, :2]])  # and the corners of furniture
    about = np.pad(np.column_stack([plan.features.kinds, plan.features.sizes]), ((0, 4 * len(plan.furniture)), (0, 0)))
    for room in rooms:
        low, high = room.polygon.min(axis=0) - 0.05, room.polygon.max(axis=0) + 0.05
        inside = ((positions >= low) & (positions <= high)).all(axis=1)
        offset = positions[inside] - room.polygon.min(axis=0)
        if low[1] < 0.0:  # below the corridor: mirrored
            offset[:, 1] = room.polygon[:, 1].max() - positions[inside, 1]
        view = np.column_stack([offset, about[inside]])
        views.append(view[np.lexsort(view.round(3).T)])
    for view in views[1:]:
        np.testing.assert_allclose(view, views[0], atol=2e-3)
    for above in (True, False):
        lefts = np.sort([room.polygon[:, 0].min() for room in rooms if (room.polygon[:, 1].min() > corridor) == above])
        np.testing.assert_allclose(np.diff(lefts, 2), 0.0, atol=2e-3)


@pytest.mark.parametrize(
    ("build", "field"),
    [
        (lambda: OfficeGenerator(rooms=4.5), "OfficeGenerator.rooms: 4.5 is not a whole number"),
        (lambda: OfficeGenerator(door_width=1.0), r"OfficeGenerator.door_width: 1.0 is not a range \(smallest, larg"),
        (lambda: OfficeGenerator(door_width=(0.3, 1.0)), "OfficeGenerator.door_width"),
        (lambda: OfficeGenerator(door_width=(1.2, 1.0)), "OfficeGenerator.door_width"),
        (lambda: OfficeGenerator(room_width=(1.0, 5.0)), "OfficeGenerator.room_width"),
        (lambda: OfficeGenerator(corridor_width=(0.5, 2.0)), "OfficeGenerator.corridor_width"),
        (lambda: OfficeGenerator(wall_thickness=float("nan")), "OfficeGenerator.wall_thickness"),
        (lambda: OfficeGenerator(joined=1.5), "OfficeGenerator.joined"),
        (lambda: AliasedGenerator(rooms=1_000), "AliasedGenerator.rooms"),
        (lambda: AliasedGenerator(room_depth=(4.0, 500.0)), "AliasedGenerator.room_depth"),
        (lambda: HallGenerator(length=(0.0, 20.0)), "HallGenerator.length"),
        (lambda: Contents(pillars=-1.0), "Contents.pillars"),
        (lambda: Contents(pilaster_depth=(0.5, 0.2)), "Contents.pilaster_depth"),
    ],
)
def test_impossible_parameters_are_refused_by_name(build, field):
    with pytest.raises(ValueError, match=field):
        build()


@every_generator
def test_each_door_has_four_jambs_of_its_width(generator):
    plan = draw(generator)
    features = plan.features
    jamb = features.kinds == Kind.DOOR_JAMB
    assert jamb.sum() == 4 * len(plan.doors)
    for door in plan.doors:
        assert 0.9 <= door.width <= 1.3
        near = np.hypot(*(features.positions - door.position).T) < 0.5 * door.width + 0.2
        assert near.sum() == 4 and jamb[near].all()
        np.testing.assert_allclose(features.sizes[near], door.width)


def random_rectangles(rng, count):
    low = rng.integers(0, 12, (count, 2))
    return np.hstack([low, low + rng.integers(1, 6, (count, 2))]).astype(float)


def paint(free, blocked, size=20):
    image = np.zeros((size, size), dtype=bool)
    for rectangles, value in ((free, True), (blocked, False)):
        for x1, y1, x2, y2 in rectangles.astype(int):
            image[y1 + 1 : y2 + 1, x1 + 1 : x2 + 1] = value
    return image


@for_seeds(20)
def test_agrees_with_pixels(seed):
    rng = np.random.default_rng(seed)
    free, blocked = random_rectangles(rng, rng.integers(1, 7)), random_rectangles(rng, rng.integers(0, 4))
    image = paint(free, blocked)
    walls, corners, shorter = outline(free, blocked)

    edges = set()  # unit edges between a free and a blocked pixel
    for y, x in zip(*np.nonzero(image[:, 1:] != image[:, :-1])):
        edges.add((x, y - 1, x, y))
    for y, x in zip(*np.nonzero(image[1:] != image[:-1])):
        edges.add((x - 1, y, x, y))
    covered = []
    for x1, y1, x2, y2 in walls.astype(int):
        steps = max(x2 - x1, y2 - y1)
        dx, dy = (x2 - x1) // steps, (y2 - y1) // steps
        covered += [(x1 + i * dx, y1 + i * dy, x1 + (i + 1) * dx, y1 + (i + 1) * dy) for i in range(steps)]
    assert len(covered) == len(set(covered))
    assert set(covered) == edges

    ends = {tuple(end) for end in walls.reshape(-1, 2)}
    assert ends == {tuple(corner) for corner in corners}
    assert len(ends) == len(corners)
    for corner, length in zip(corners, shorter):
        meeting = walls[(walls[:, :2] == corner).all(axis=1) | (walls[:, 2:] == corner).all(axis=1)]
        lengths = np.abs(meeting[:, 2:] - meeting[:, :2]).sum(axis=1)
        level = meeting[:, 1] == meeting[:, 3]
        assert len(meeting) in (2, 4) and level.sum() == len(meeting) // 2  # an L, or two of them at a diagonal
        assert length == lengths.min()
