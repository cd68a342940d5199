"""Seeded floor plans: `office`, `aliased`, `hall`. A generator is a frozen record of parameters, called with an rng.

Every plan is one connected floor for a robot of radius .2 m: rooms are joined by doors, walls have thickness (so that
the two sides of a wall show different corners), and whatever stands in a room keeps its distance from the doors, from
the room's centre and from everything else. Coordinates are whole millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from slam_gym.types import Array
from slam_gym.world.floor_plan import Door, Features, FloorPlan, Kind, Room
from slam_gym.world.outline import outline

MAX_CORNER_SIZE = 4.0  # [m] a longer wall at a corner counts as this long
_PASSAGE = 0.8  # [m] between any two things that stand in a room
_DOOR_AREA = 0.6  # [m] kept free around a door, beyond half its width
_CENTRE_AREA = 0.5  # [m] kept free around the centre of a room
_MIN_DOOR = 0.8  # [m]
_JAMB = 0.3  # [m] between a door and the corner of its room
_TRIES = 40  # draws for one thing to find its place


@dataclass(frozen=True)
class Contents:
    """What stands in the rooms. Each thing is drawn at random and left out where it does not fit."""

    pilasters: float = 0.04  # [1/m] mean number along a wall; each adds four corners
    pilaster_width: tuple[float, float] = (0.3, 0.6)  # [m] along the wall
    pilaster_depth: tuple[float, float] = (0.2, 0.4)  # [m] into the room
    pillars: float = 0.4  # mean number in a room
    pillar_diameter: tuple[float, float] = (0.25, 0.6)  # [m]
    furniture: float = 0.8  # mean number of movable boxes in a room
    furniture_side: tuple[float, float] = (0.4, 0.9)  # [m]

    def __post_init__(self) -> None:
        for name in ("pilasters", "pillars", "furniture"):
            _check(f"Contents.{name}", (getattr(self, name),) * 2, 0.0, 1_000.0)
        for name in ("pilaster_width", "pilaster_depth", "pillar_diameter", "furniture_side"):
            _check(f"Contents.{name}", getattr(self, name), 0.05, 5.0)


def _check(name: str, value: tuple[float, float], low: float, high: float) -> None:
    """ValueError unless the range `value` is a range within [low, high]."""
    if not low <= value[0] <= value[1] <= high:
        raise ValueError(f"{name}: {value} is not a range (smallest, largest) within [{low:g}, {high:g}]")


def _draw(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    """Uniform in `limits` [m], a whole number of millimetres."""
    return round(float(rng.uniform(*limits)), 3)


class _Draft:
    """A floor plan under construction."""

    def __init__(self, rng: np.random.Generator, contents: Contents) -> None:
        self.rng, self.contents = rng, contents
        self.rooms: list[Room] = []
        self.doors: list[Door] = []
        self.floors: list[tuple[float, float, float, float]] = []  # of the rooms, x₁ y₁ x₂ y₂
        self.openings: list[tuple[float, float, float, float]] = []  # of the doors, through the wall
        self.blocked: list[tuple[float, float, float, float]] = []
        self.pillars: list[tuple[float, float, float]] = []  # x, y, diameter
        self.furniture: list[tuple[float, float, float, float, float]] = []
        self.kept_free: list[tuple[float, float, float]] = []  # x, y, radius of the discs in which nothing may stand

    def add_room(self, name: str, x1: float, y1: float, x2: float, y2: float) -> None:
        self.floors.append((x1, y1, x2, y2))
        self.rooms.append(Room(name, np.array([[x1, y1], [x2, y1], [x2, y2], [x1, y2]])))
        self.kept_free.append(((x1 + x2) / 2, (y1 + y2) / 2, _CENTRE_AREA))

    def add_door(self, a: str, b: str, x1: float, y1: float, x2: float, y2: float, upright: bool) -> None:
        """A door as the rectangle that it cuts out of a wall; `upright`: the wall runs along y."""
        self.openings.append((x1, y1, x2, y2))
        x, y, width = (x1 + x2) / 2, (y1 + y2) / 2, round(y2 - y1 if upright else x2 - x1, 3)
        self.doors.append(Door(np.array([x, y]), width, (a, b)))
        self.kept_free.append((x, y, width / 2 + _DOOR_AREA))

    def fits(self, x: float, y: float, radius: float) -> bool:
        """A thing of this radius leaves doors, room centres and passages free."""
        return all((x - u) ** 2 + (y - v) ** 2 >= (radius + r) ** 2 for u, v, r in self.kept_free)

    def furnish(self, room: Room) -> None:
        """Pilasters, then pillars, then furniture, each where it finds a place."""
        x1, y1, x2, y2 = self.floors[self.rooms.index(room)]
        things = self.contents
        for _ in range(self.rng.poisson(things.pilasters * 2 * (x2 - x1 + y2 - y1))):
            self._place_pilaster(x1, y1, x2, y2)
        for _ in range(self.rng.poisson(things.pillars)):
            diameter = _draw(self.rng, things.pillar_diameter)
            if place := self._place(x1, y1, x2, y2, diameter / 2, _PASSAGE):
                self.pillars.append((*place, diameter))
        for _ in range(self.rng.poisson(things.furniture)):
            sides = _draw(self.rng, things.furniture_side), _draw(self.rng, things.furniture_side)
            length, width, heading = max(sides), min(sides), float(np.round(self.rng.uniform(-np.pi, np.pi), 3))
            if place := self._place(x1, y1, x2, y2, float(np.hypot(length, width)) / 2, 0.05):
                self.furniture.append((*place, length, width, heading))

    def _place(
        self, x1: float, y1: float, x2: float, y2: float, radius: float, wall: float
    ) -> tuple[float, float] | None:
        """A place in a room for a thing of `radius` that keeps `wall` [m] from the walls; None if none was found.

        Rooms too narrow for a passage on either side of it, like corridors, get none.
        """
        margin = radius + wall
        if min(x2 - x1, y2 - y1) < 2 * (radius + _PASSAGE):
            return None
        for _ in range(_TRIES):
            x, y = _draw(self.rng, (x1 + margin, x2 - margin)), _draw(self.rng, (y1 + margin, y2 - margin))
            if self.fits(x, y, radius):
                self.kept_free.append((x, y, radius + _PASSAGE))
                return x, y
        return None

    def _place_pilaster(self, x1: float, y1: float, x2: float, y2: float) -> None:
        """A block against a wall of the room, clear of its corners."""
        width, depth = _draw(self.rng, self.contents.pilaster_width), _draw(self.rng, self.contents.pilaster_depth)
        across, along = x2 - x1, y2 - y1
        side = int(self.rng.choice(4, p=np.array([across, across, along, along]) / (2 * (across + along))))
        low, high = (x1, x2) if side < 2 else (y1, y2)
        if high - low < width + 1.2:
            return
        for _ in range(_TRIES):
            start = _draw(self.rng, (low + 0.6, high - 0.6 - width))
            end = round(start + width, 3)
            block = (
                (start, y1, end, round(y1 + depth, 3)),
                (start, round(y2 - depth, 3), end, y2),
                (x1, start, round(x1 + depth, 3), end),
                (round(x2 - depth, 3), start, x2, end),
            )[side]
            x, y, radius = (block[0] + block[2]) / 2, (block[1] + block[3]) / 2, float(np.hypot(width, depth)) / 2
            if self.fits(x, y, radius):
                self.blocked.append(block)
                self.kept_free.append((x, y, radius + _PASSAGE))
                return

    def finish(self, name: str) -> FloorPlan:
        """Walls and features from the outline of what is free."""
        walls, corners, sizes = outline(np.array(self.floors + self.openings), np.array(self.blocked).reshape(-1, 4))
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
        return FloorPlan(
            name, walls, features, tuple(self.rooms), tuple(self.doors), np.array(self.furniture).reshape(-1, 5)
        )


def pillar_outline(x: float, y: float, diameter: float) -> Array:
    """(8, 4) [m] the octagon inscribed in a pillar."""
    angles = (np.arange(9) + 0.5) * np.pi / 4
    ring = np.stack([x + np.cos(angles) * diameter / 2, y + np.sin(angles) * diameter / 2], axis=1)
    return np.hstack([ring[:-1], ring[1:]])


@dataclass(frozen=True)
class _Bay:
    """A room off the corridor, as drawn: its size and its door."""

    width: float  # [m] along the corridor
    depth: float  # [m]
    door: float  # [m] where the door begins, from the room's left end
    door_width: float  # [m]


def _draw_bay(rng: np.random.Generator, width: float, depths: tuple[float, float], doors: tuple[float, float]) -> _Bay:
    depth, door_width = _draw(rng, depths), _draw(rng, doors)
    return _Bay(width, depth, _draw(rng, (_JAMB, width - _JAMB - door_width)), door_width)


def _lay_out(draft: _Draft, rows: list[list[_Bay]], corridor: float, wall: float) -> list[list[Room]]:
    """Put the first row of rooms above the corridor and the second, mirrored, below it."""
    length = max(sum(bay.width + wall for bay in row) - wall for row in rows)
    draft.add_room("corridor", 0.0, 0.0, round(length, 3), corridor)
    placed = []
    for side, row in enumerate(rows):
        x = 0.0
        for bay in row:
            name = f"room {len(draft.rooms)}"
            left, right, near = round(x, 3), round(x + bay.width, 3), round(corridor + wall, 3)
            draft.add_room(name, *_sided(side, corridor, left, near, right, near + bay.depth))
            start, end = round(left + bay.door, 3), round(left + bay.door + bay.door_width, 3)
            draft.add_door("corridor", name, *_sided(side, corridor, start, corridor, end, near), upright=False)
            x += bay.width + wall
        placed.append(draft.rooms[len(draft.rooms) - len(row) :])
    return placed


def _sided(side: int, corridor: float, x1: float, y1: float, x2: float, y2: float) -> tuple[float, float, float, float]:
    """A rectangle above the corridor (side 0) or its mirror image below (side 1)."""
    return (
        (x1, round(y1, 3), x2, round(y2, 3))
        if side == 0
        else (x1, round(corridor - y2, 3), x2, round(corridor - y1, 3))
    )


@dataclass(frozen=True)
class OfficeGenerator:
    """Rooms of different sizes on both sides of a corridor, a door each; some neighbours share a second door.

    The rows of the two sides are stretched towards one length, each by at most a quarter.
    """

    rooms: int = 9
    room_width: tuple[float, float] = (3.6, 6.0)  # [m] along the corridor, before stretching
    room_depth: tuple[float, float] = (4.4, 6.0)  # [m]
    corridor_width: tuple[float, float] = (1.8, 2.4)  # [m]
    door_width: tuple[float, float] = (0.9, 1.3)  # [m]
    wall_thickness: float = 0.2  # [m]
    joined: float = 0.4  # probability of a door between two neighbours
    contents: Contents = field(default_factory=Contents)

    def __post_init__(self) -> None:
        _check_building(self, self.rooms, self.room_width, self.room_depth)
        _check("OfficeGenerator.joined", (self.joined,) * 2, 0.0, 1.0)

    def __call__(self, rng: np.random.Generator) -> FloorPlan:
        draft = _Draft(rng, self.contents)
        above = (self.rooms + int(rng.integers(2))) // 2
        widths = [[_draw(rng, self.room_width) for _ in range(count)] for count in (above, self.rooms - above) if count]
        target = sum(map(sum, widths)) / len(widths)
        rows = []
        for row in widths:
            stretch = min(max(target / sum(row), 0.8), 1.25)
            stretched = [round(width * stretch, 3) for width in row]
            rows.append([_draw_bay(rng, width, self.room_depth, self.door_width) for width in stretched])
        for neighbours in _lay_out(draft, rows, _draw(rng, self.corridor_width), self.wall_thickness):
            for a, b in pairwise(neighbours):
                if rng.random() < self.joined:
                    self._join(draft, a, b)
        for room in draft.rooms:
            draft.furnish(room)
        return draft.finish("office")

    def _join(self, draft: _Draft, a: Room, b: Room) -> None:
        """A door through the wall between two neighbours, a on the left."""
        bottom = max(a.polygon[:, 1].min(), b.polygon[:, 1].min())
        top = min(a.polygon[:, 1].max(), b.polygon[:, 1].max())
        width = _draw(draft.rng, self.door_width)
        start = _draw(draft.rng, (bottom + _JAMB, top - _JAMB - width))
        left, right = a.polygon[:, 0].max(), b.polygon[:, 0].min()
        draft.add_door(a.name, b.name, left, start, right, round(start + width, 3), upright=True)


@dataclass(frozen=True)
class AliasedGenerator:
    """Identical rooms, equally spaced on both sides of a corridor: only the ends of the corridor tell them apart."""

    rooms: int = 10
    room_width: tuple[float, float] = (3.6, 4.4)  # [m] along the corridor
    room_depth: tuple[float, float] = (4.4, 5.2)  # [m]
    corridor_width: tuple[float, float] = (1.8, 2.4)  # [m]
    door_width: tuple[float, float] = (0.9, 1.3)  # [m]
    wall_thickness: float = 0.2  # [m]
    contents: Contents = field(default_factory=lambda: Contents(pilasters=0.06, pillars=0.7))

    def __post_init__(self) -> None:
        _check_building(self, self.rooms, self.room_width, self.room_depth)

    def __call__(self, rng: np.random.Generator) -> FloorPlan:
        draft = _Draft(rng, self.contents)
        bay = _draw_bay(rng, _draw(rng, self.room_width), self.room_depth, self.door_width)
        above = (self.rooms + 1) // 2
        corridor = _draw(rng, self.corridor_width)
        rows = [[bay] * count for count in (above, self.rooms - above) if count]
        placed = _lay_out(draft, rows, corridor, self.wall_thickness)
        draft.furnish(placed[0][0])
        blocked, pillars, furniture = list(draft.blocked), list(draft.pillars), list(draft.furniture)
        pitch = bay.width + self.wall_thickness
        for side, row in enumerate(placed):
            for i in range(side == 0, len(row)):
                shift, sign = i * pitch, 1.0 - 2.0 * side
                y0 = side * corridor
                for x1, y1, x2, y2 in blocked:
                    left, right = round(x1 + shift, 3), round(x2 + shift, 3)
                    draft.blocked.append(_sided(side, corridor, left, y1, right, y2))
                draft.pillars += [(round(x + shift, 3), round(y0 + sign * y, 3), size) for x, y, size in pillars]
                draft.furniture += [
                    (round(x + shift, 3), round(y0 + sign * y, 3), length, width, sign * heading)
                    for x, y, length, width, heading in furniture
                ]
        return draft.finish("aliased")


@dataclass(frozen=True)
class HallGenerator:
    """One large room with irregular pillars."""

    length: tuple[float, float] = (18.0, 22.0)  # [m]
    width: tuple[float, float] = (18.0, 22.0)  # [m]
    contents: Contents = field(
        default_factory=lambda: Contents(pilasters=0.06, pillars=42, pillar_diameter=(0.25, 0.8), furniture=3)
    )

    def __post_init__(self) -> None:
        for name in ("length", "width"):
            _check(f"HallGenerator.{name}", getattr(self, name), 2.0, 500.0)

    def __call__(self, rng: np.random.Generator) -> FloorPlan:
        draft = _Draft(rng, self.contents)
        draft.add_room("hall", 0.0, 0.0, _draw(rng, self.length), _draw(rng, self.width))
        draft.furnish(draft.rooms[0])
        return draft.finish("hall")


def _check_building(
    generator: OfficeGenerator | AliasedGenerator,
    rooms: int,
    room_width: tuple[float, float],
    room_depth: tuple[float, float],
) -> None:
    """ValueError naming the field of a generator of rooms off a corridor that cannot be built."""
    name = type(generator).__name__
    if not 1 <= rooms <= 200:
        raise ValueError(f"{name}.rooms: {rooms} is not in 1 … 200")
    _check(f"{name}.door_width", generator.door_width, _MIN_DOOR, 5.0)
    _check(f"{name}.wall_thickness", (generator.wall_thickness,) * 2, 0.05, 1.0)
    _check(f"{name}.corridor_width", generator.corridor_width, 1.5, 20.0)
    smallest = 1.25 * (generator.door_width[1] + 2 * _JAMB)  # a row may be shortened to .8 of its length
    _check(f"{name}.room_width", room_width, smallest, 50.0)
    _check(f"{name}.room_depth", room_depth, smallest, 50.0)
