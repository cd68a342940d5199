"""FloorPlan: what it accepts, and what it refuses by name."""

import numpy as np
import pytest

from slam_gym.world.floor_plan import Door, Features, FloorPlan, FloorPlanError, Room
from tests.oracles.statistics import for_seeds

SQUARE = [[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 4.0], [4.0, 4.0, 0.0, 4.0], [0.0, 4.0, 0.0, 0.0]]
CORNERS = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]


def square(**changes):
    fields = {
        "name": "square",
        "walls": SQUARE,
        "features": Features(CORNERS, [0, 0, 1, 2], [4.0, 4.0, 1.0, 0.5]),
        "rooms": (Room("left", [[0, 0], [2, 0], [2, 4], [0, 4]]), Room("right", [[2, 0], [4, 0], [4, 4], [2, 4]])),
        "doors": (Door([2.0, 2.0], 1.0, ("left", "right")),),
        "furniture": [[1.0, 1.0, 0.6, 0.4, 0.3]],
    }
    return FloorPlan(**{**fields, **changes})


def test_arrays_are_contiguous_copies():
    walls = np.asfortranarray(SQUARE)
    plan = square(walls=walls)
    walls[0, 0] = 99.0
    assert plan.walls[0, 0] == 0.0
    assert plan.walls.flags.c_contiguous and plan.features.kinds.dtype == np.int64
    assert plan.walls.dtype == plan.furniture.dtype == plan.features.positions.dtype == np.float64


@pytest.mark.parametrize(
    ("build", "field", "reason"),
    [
        (lambda: square(walls=[]), "walls", "none"),
        (lambda: square(walls=[[0, 0, 1]]), "walls", "shape"),
        (lambda: square(walls=[[0, 0, 1], [0]]), "walls", "not a table of numbers"),
        (lambda: square(walls=[["0", "0", "1", "1"]]), "walls", "not a table of numbers"),
        (lambda: square(walls=[*SQUARE, [1, 1, 1, 1]]), "walls[4]", "no length"),
        (lambda: square(walls=[*SQUARE, [1, 1, np.nan, 1]]), "walls[4]", "not finite"),
        (lambda: square(walls=[*SQUARE, [1, 1, 1e4, 1]]), "walls[4]", "beyond"),
        (lambda: square(walls=[[-1500, 0, 0, 0], [0, 0, 1500, 0]]), "walls", "longer"),
        (lambda: Features([[np.inf, 0]], [0], [1]), "features.positions[0]", "not finite"),
        (lambda: Features([[0, 0], [1, 1]], [0], [1]), "features", "2 positions, 1 kinds"),
        (lambda: Features([[0, 0]], [7], [1]), "features.kinds[0]", "no known kind"),
        (lambda: Features([[0, 0]], [0.5], [1]), "features.kinds[0]", "no known kind"),
        (lambda: Features([[0, 0]], [0], [0.0]), "features.sizes[0]", "not in (0"),
        (lambda: Features([[0, 0]], [0], [1e3]), "features.sizes[0]", "not in (0"),
        (lambda: Features([[0, 0], [1, 1], [0, 0]], [0] * 3, [1] * 3), "features.positions[2]", "repeats"),
        (lambda: square(features=Features([[50, 50]], [0], [1])), "features.positions[0]", "outside"),
        (lambda: Room("sliver", [[0, 0], [1, 1], [2, 2]]), "room 'sliver': polygon", "no area"),
        (lambda: Room("line", [[0, 0], [1, 1]]), "room 'line': polygon", "no area"),
        (lambda: square(rooms=(square().rooms[0],) * 2, doors=()), "rooms[1]", "repeats a name"),
        (lambda: square(rooms=()), "doors[0].rooms", "unknown room"),
        (lambda: Door([0, 0], -1.0, ("a", "b")), "door: width[0]", "not in (0"),
        (lambda: Door([0, 0], 1.0, ("a", "a")), "door: rooms", "not two different rooms"),
        (lambda: square(furniture=[[1, 1, 0, 1, 0]]), "furniture.length[0]", "not in (0"),
        (lambda: square(furniture=[[1, 1, 1, 500, 0]]), "furniture.width[0]", "not in (0"),
        (lambda: square(furniture=[[1, 90, 1, 1, 0]]), "furniture[0]", "outside"),
    ],
)
def test_bad_geometry_is_refused_by_name(build, field, reason):
    with pytest.raises(ValueError) as caught:
        build()
    assert isinstance(caught.value, FloorPlanError)
    assert caught.value.field == field
    assert reason in caught.value.reason


def winding(polygon, point):
    """Turns of the outline around a point: ±1 inside a simple polygon, 0 outside."""
    angles = np.arctan2(*(polygon - point).T[::-1])
    turns = np.mod(np.diff(np.append(angles, angles[0])) + np.pi, 2 * np.pi) - np.pi
    return round(float(turns.sum()) / (2 * np.pi))


@for_seeds(10)
def test_contains_agrees_with_the_winding_number(seed):
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 12))
    polygon = rng.uniform(0.5, 3.0, 12)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    polygon = polygon[:: rng.choice([-1, 1])]
    points = rng.uniform(-3, 3, (300, 2))
    expected = [winding(polygon, point) != 0 for point in points]
    np.testing.assert_array_equal(Room("star", polygon).contains(points), expected)
