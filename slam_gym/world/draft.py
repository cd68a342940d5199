"""A floor plan under construction: rooms, doors between them, and the contents of the rooms."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slam_gym.types import Array, BoolArray, IntArray
from slam_gym.world.floor_plan import Door, Features, FloorPlan, Kind, Room

MAX_CORNER_SIZE = 4.0  # [m] a longer wall at a corner counts as this long
_PASSAGE = 0.8  # [m] between any two objects in a room
_DOOR_AREA = 0.6  # [m] kept free around a door, beyond half its width
_CENTRE_AREA = 0.5  # [m] kept free around the centre of a room
_TO_CORNER = 0.6  # [m] between a pilaster and the corners of the room
_TRIES = 40  # random places that are tried for one object

Limits = tuple[float, float]
"""Smallest and largest value."""


@dataclass(frozen=True)
class Contents:
    """The contents of the rooms. Each object is placed at random, and left out where it does not fit."""

    pilasters: float = 0.04  # [1/m] mean number along a wall; each adds four corners
    pilaster_width: Limits = (0.3, 0.6)  # [m] along the wall
    pilaster_depth: Limits = (0.2, 0.4)  # [m] into the room
    pillars: float = 0.4  # mean number in a room
    pillar_diameter: Limits = (0.25, 0.6)  # [m]
    furniture: float = 0.8  # mean number of movable boxes in a room
    furniture_side: Limits = (0.4, 0.9)  # [m]

    def __post_init__(self) -> None:
        check_limits(self, 0.0, 1_000.0, "pilasters", "pillars", "furniture")
        check_limits(self, 0.05, 5.0, "pilaster_width", "pilaster_depth", "pillar_diameter", "furniture_side")


def check_limits(settings: object, low: float, high: float, *names: str) -> None:
    """Raise ValueError, naming the field, unless these fields are numbers in [low, high], or ranges of two numbers, as
    their defaults are."""
    for name in names:
        given, default = getattr(settings, name), getattr(type(settings), name)
        value, whole = np.ravel(given), isinstance(default, int)
        fits = np.shape(given) == np.shape(default) and value.dtype.kind in ("iu" if whole else "iuf")
        if not (fits and low <= value[0] <= value[-1] <= high):
            what = "a range (smallest, largest)" if np.ndim(default) else "a whole number" if whole else "a number"
            raise ValueError(f"{type(settings).__name__}.{name}: {given!r} is not {what} within [{low:g}, {high:g}]")


def draw(rng: np.random.Generator, limits: Limits) -> float:
    """A length drawn uniformly from `limits` [m], rounded to whole millimetres."""
    return round(float(rng.uniform(*limits)), 3)


class Rectangle(NamedTuple):
    """A rectangle along the axes, [m] W."""

    x1: float
    y1: float
    x2: float
    y2: float

    @property
    def centre(self) -> tuple[float, float]:
        return (self.x1 + self.x2) / 2, (self.y1 + self.y2) / 2

    @property
    def sides(self) -> tuple[float, float]:
        """Lengths [m] along x and along y."""
        return self.x2 - self.x1, self.y2 - self.y1


class Draft:
    """A floor plan under construction."""

    def __init__(self, rng: np.random.Generator, contents: Contents) -> None:
        self.rng, self.contents = rng, contents
        self.rooms: dict[str, Rectangle] = {}  # their floors
        self.openings: list[Rectangle] = []  # of the doors, through the wall
        self.doors: list[Door] = []
        self.blocked: list[Rectangle] = []
        self.pillars: list[tuple[float, float, float]] = []  # x, y, diameter
        self.furniture: list[tuple[float, float, float, float, float]] = []
        self.kept_free: list[tuple[float, float, float]] = []  # x, y, radius of discs in which nothing may stand

    def add_room(self, name: str, floor: Rectangle) -> None:
        self.rooms[name] = floor
        self.kept_free.append((*floor.centre, _CENTRE_AREA))

    def add_door(self, a: str, b: str, opening: Rectangle, upright: bool) -> None:
        """Add a door, given the rectangle that it cuts out of a wall; `upright` says that the wall runs along y."""
        width = round(opening.sides[int(upright)], 3)
        self.openings.append(opening)
        self.doors.append(Door(np.array(opening.centre), width, (a, b)))
        self.kept_free.append((*opening.centre, width / 2 + _DOOR_AREA))

    def fits(self, x: float, y: float, radius: float) -> bool:
        """Whether an object of this radius leaves doors, room centres and passages free."""
        return all((x - u) ** 2 + (y - v) ** 2 >= (radius + r) ** 2 for u, v, r in self.kept_free)

    def furnish(self, floor: Rectangle) -> None:
        """Place pilasters, then pillars, then furniture, each where it fits."""
        contents = self.contents
        for _ in range(self.rng.poisson(contents.pilasters * 2 * (floor.x2 - floor.x1 + floor.y2 - floor.y1))):
            self._place_pilaster(floor)
        for _ in range(self.rng.poisson(contents.pillars)):
            diameter = draw(self.rng, contents.pillar_diameter)
            if place := self._place(floor, diameter / 2, _PASSAGE):
                self.pillars.append((*place, diameter))
        for _ in range(self.rng.poisson(contents.furniture)):
            sides = draw(self.rng, contents.furniture_side), draw(self.rng, contents.furniture_side)
            length, width, heading = max(sides), min(sides), float(np.round(self.rng.uniform(-np.pi, np.pi), 3))
            if place := self._place(floor, float(np.hypot(length, width)) / 2, 0.05):
                self.furniture.append((*place, length, width, heading))

    def _place(self, floor: Rectangle, radius: float, clearance: float) -> tuple[float, float] | None:
        """A place in a room for an object of `radius` [m] at least `clearance` [m] from the walls, or None."""
        margin = radius + clearance
        if min(floor.sides) < 2 * (radius + _PASSAGE):  # no passage on either side of it, as in a corridor
            return None
        for _ in range(_TRIES):
            x = draw(self.rng, (floor.x1 + margin, floor.x2 - margin))
            y = draw(self.rng, (floor.y1 + margin, floor.y2 - margin))
            if self.fits(x, y, radius):
                self.kept_free.append((x, y, radius + _PASSAGE))
                return x, y
        return None

    def _place_pilaster(self, floor: Rectangle) -> None:
        """Place a block against a wall of the room, clear of its corners, if it fits."""
        width, depth = draw(self.rng, self.contents.pilaster_width), draw(self.rng, self.contents.pilaster_depth)
        (x1, y1, x2, y2), (across, along) = floor, floor.sides
        side = int(self.rng.choice(4, p=np.array([across, across, along, along]) / (2 * (across + along))))
        low, high = (x1, x2) if side < 2 else (y1, y2)
        if high - low < width + 2 * _TO_CORNER or (along if side < 2 else across) < depth + _PASSAGE:
            return
        for _ in range(_TRIES):
            start = draw(self.rng, (low + _TO_CORNER, high - _TO_CORNER - width))
            end = round(start + width, 3)
            block = (
                Rectangle(start, y1, end, round(y1 + depth, 3)),
                Rectangle(start, round(y2 - depth, 3), end, y2),
                Rectangle(x1, start, round(x1 + depth, 3), end),
                Rectangle(round(x2 - depth, 3), start, x2, end),
            )[side]
            radius = float(np.hypot(width, depth)) / 2
            if self.fits(*block.centre, radius):
                self.blocked.append(block)
                self.kept_free.append((*block.centre, radius + _PASSAGE))
                return

    def finish(self, name: str) -> FloorPlan:
        """The floor plan, with walls and features from the outline of free space."""
        free = np.array([*self.rooms.values(), *self.openings])
        walls, corners, sizes = outline(free, np.array(self.blocked).reshape(-1, 4))
        kinds = np.full(len(corners), int(Kind.CORNER))
        sizes = np.minimum(sizes, MAX_CORNER_SIZE)
        for door, (x1, y1, x2, y2) in zip(self.doors, self.openings):
            jamb = np.isin(corners[:, 0], (x1, x2)) & np.isin(corners[:, 1], (y1, y2))
            kinds[jamb], sizes[jamb] = int(Kind.DOOR_JAMB), door.width
        pillars = np.array(self.pillars).reshape(-1, 3)
        features = Features(
            np.vstack([corners, pillars[:, :2]]),
            np.concatenate([kinds, np.full(len(pillars), int(Kind.PILLAR))]),
            np.round(np.concatenate([sizes, pillars[:, 2]]), 3),
        )
        walls = np.vstack([walls, *(pillar_outline(*pillar) for pillar in self.pillars)])
        rooms = [
            Room(name, np.array([[x1, y1], [x2, y1], [x2, y2], [x1, y2]]))
            for name, (x1, y1, x2, y2) in self.rooms.items()
        ]
        furniture = np.array(self.furniture).reshape(-1, 5)
        return FloorPlan(name, walls, features, tuple(rooms), tuple(self.doors), furniture)


def pillar_outline(x: float, y: float, diameter: float) -> Array:
    """The octagon inscribed in a pillar, (8, 4) [m]."""
    angles = (np.arange(9) + 0.5) * np.pi / 4
    ring = np.stack([x + np.cos(angles) * diameter / 2, y + np.sin(angles) * diameter / 2], axis=1)
    return np.hstack([ring[:-1], ring[1:]])


def _covered(rectangles: Array, xs: Array, ys: Array) -> BoolArray:
    """(len(ys) − 1, len(xs) − 1) which cells of the grid xs × ys lie in one of `rectangles` (r, 4) x₁ y₁ x₂ y₂ [m]."""
    cells = np.zeros((len(ys) - 1, len(xs) - 1), dtype=bool)
    for x1, y1, x2, y2 in rectangles:
        (i1, i2), (j1, j2) = np.searchsorted(ys, (y1, y2)), np.searchsorted(xs, (x1, x2))
        cells[i1:i2, j1:j2] = True
    return cells


def _runs(edges: BoolArray, corners: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """Maximal runs of wall along the grid lines, cut at corners: the line, first and last grid point of each, (s,).

    `edges` (lines, cells) says where a line separates free from blocked, `corners` (lines, cells + 1) where it turns.
    """
    joined = np.pad(edges, ((0, 0), (1, 1)))
    lines, first = np.nonzero(joined[:, 1:] & (~joined[:, :-1] | corners))
    _, last = np.nonzero(joined[:, :-1] & (~joined[:, 1:] | corners))
    return lines, first, last


def outline(free: Array, blocked: Array) -> tuple[Array, Array, Array]:
    """Outline of ∪ `free` ∖ ∪ `blocked`, both rectangles (·, 4) x₁ y₁ x₂ y₂ [m].

    Returns walls (s, 4) [m], each from one corner to the next; corners (c, 2) [m], without repetition; and (c,) [m] the
    length of the shorter of the walls that meet at each corner. A grid point is a corner unless none, all, or two
    adjacent ones of the four cells around it are free.
    """
    edges = np.vstack([free, blocked])
    xs, ys = np.unique(edges[:, 0::2]), np.unique(edges[:, 1::2])
    cells = np.pad(_covered(free, xs, ys) & ~_covered(blocked, xs, ys), 1)
    around = np.stack([cells[:-1, :-1], cells[:-1, 1:], cells[1:, 1:], cells[1:, :-1]]).astype(np.int64)
    count = around.sum(axis=0)
    corner = (count % 2 == 1) | ((count == 2) & (around[0] == around[2]))
    rows, left, right = _runs((cells[:-1] != cells[1:])[:, 1:-1], corner)
    columns, low, high = _runs((cells[:, :-1] != cells[:, 1:])[1:-1].T, corner.T)
    level = np.stack([xs[left], ys[rows], xs[right], ys[rows]], axis=1)
    walls = np.vstack([level, np.stack([xs[columns], ys[low], xs[columns], ys[high]], axis=1)])
    i, j = np.nonzero(corner)
    corners = np.stack([xs[j], ys[i]], axis=1)
    lengths = np.abs(walls[:, 2:] - walls[:, :2]).sum(axis=1)
    touches = (corners[:, None, None, :] == walls.reshape(1, -1, 2, 2)).all(axis=-1).any(axis=-1)
    shorter: Array = np.where(touches, lengths, np.inf).min(axis=1, initial=np.inf)
    return walls, corners, shorter
