"""Seeded floor plans: `office`, `aliased`, `hall`, `loop`.

A generator is a frozen record of parameters that is called with a random generator.

Every plan is one connected floor for a robot of radius 0.2 m: rooms are joined by doors, walls have thickness (so that
the two sides of a wall have different corners), and every object in a room keeps its distance from the doors, from the
room's centre and from all other objects. Coordinates are whole millimetres.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from slam_gym.world.draft import Contents, Draft, Limits, Rectangle, check_limits, draw
from slam_gym.world.floor_plan import FloorPlan

_MIN_DOOR = 0.8  # [m]
_JAMB = 0.3  # [m] between a door and the corner of its room


class _Bay(NamedTuple):
    """A room off the corridor: its size and its door, as drawn at random."""

    width: float  # [m] along the corridor
    depth: float  # [m]
    door: float  # [m] where the door begins, from the room's left end
    door_width: float  # [m]


def _draw_bay(rng: np.random.Generator, width: float, depths: Limits, doors: Limits) -> _Bay:
    depth, door_width = draw(rng, depths), draw(rng, doors)
    return _Bay(width, depth, draw(rng, (_JAMB, width - _JAMB - door_width)), door_width)


def _lay_out(draft: Draft, rows: list[list[_Bay]], corridor: float, wall: float) -> list[list[str]]:
    """Put the first row of rooms above the corridor and the second, mirrored, below it; returns the names by row."""
    length = max(sum(bay.width + wall for bay in row) - wall for row in rows)
    draft.add_room("corridor", Rectangle(0.0, 0.0, round(length, 3), corridor))
    placed: list[list[str]] = []
    for side, row in enumerate(rows):
        x, near = 0.0, round(corridor + wall, 3)
        placed.append([])
        for bay in row:
            left, right = round(x, 3), round(x + bay.width, 3)
            room = f"room {len(draft.rooms)}"
            draft.add_room(room, _sided(side, corridor, left, near, right, near + bay.depth))
            start, end = round(left + bay.door, 3), round(left + bay.door + bay.door_width, 3)
            opening = _sided(side, corridor, start, corridor, end, near)
            draft.add_door("corridor", room, opening, upright=False)
            placed[side].append(room)
            x += bay.width + wall
    return placed


def _sided(side: int, corridor: float, x1: float, y1: float, x2: float, y2: float) -> Rectangle:
    """A rectangle above the corridor (side 0) or its mirror image below (side 1)."""
    if side == 0:
        return Rectangle(x1, round(y1, 3), x2, round(y2, 3))
    return Rectangle(x1, round(corridor - y2, 3), x2, round(corridor - y1, 3))


@dataclass(frozen=True)
class _Building:
    """Rooms off a corridor. Raises ValueError, naming the field, for parameters that cannot be built."""

    rooms: int = 9
    room_width: Limits = (3.6, 6.0)  # [m] along the corridor, before stretching
    room_depth: Limits = (4.4, 6.0)  # [m]
    corridor_width: Limits = (1.8, 2.4)  # [m]
    door_width: Limits = (0.9, 1.3)  # [m]
    wall_thickness: float = 0.2  # [m]

    def __post_init__(self) -> None:
        check_limits(self, 1, 200, "rooms")
        check_limits(self, _MIN_DOOR, 5.0, "door_width")
        check_limits(self, 0.05, 1.0, "wall_thickness")
        check_limits(self, 1.5, 20.0, "corridor_width")
        smallest = 1.25 * (self.door_width[1] + 2 * _JAMB)  # a row may be shortened to 0.8 of its length
        check_limits(self, smallest, 50.0, "room_width", "room_depth")


@dataclass(frozen=True)
class OfficeGenerator(_Building):
    """Rooms of different sizes on both sides of a corridor, each with a door to it; doors also join some neighbours.

    The rows of the two sides are stretched towards one length, each by at most a quarter.
    """

    joined: float = 0.4  # probability of a door between two neighbours
    contents: Contents = field(default_factory=Contents)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_limits(self, 0.0, 1.0, "joined")

    def __call__(self, rng: np.random.Generator) -> FloorPlan:
        draft = Draft(rng, self.contents)
        above = (self.rooms + int(rng.integers(2))) // 2
        widths = [[draw(rng, self.room_width) for _ in range(count)] for count in (above, self.rooms - above) if count]
        target = sum(map(sum, widths)) / len(widths)
        rows = []
        for row in widths:
            stretch = min(max(target / sum(row), 0.8), 1.25)
            stretched = [round(width * stretch, 3) for width in row]
            rows.append([_draw_bay(rng, width, self.room_depth, self.door_width) for width in stretched])
        for neighbours in _lay_out(draft, rows, draw(rng, self.corridor_width), self.wall_thickness):
            for a, b in pairwise(neighbours):
                if rng.random() < self.joined:
                    self._join(draft, a, b)
        for floor in draft.rooms.values():
            draft.furnish(floor)
        return draft.finish("office")

    def _join(self, draft: Draft, a: str, b: str) -> None:
        """Add a door through the wall between two neighbours, `a` being the left one."""
        left, right = draft.rooms[a], draft.rooms[b]
        bottom, top = max(left.y1, right.y1), min(left.y2, right.y2)
        width = draw(draft.rng, self.door_width)
        start = draw(draft.rng, (bottom + _JAMB, top - _JAMB - width))
        draft.add_door(a, b, Rectangle(left.x2, start, right.x1, round(start + width, 3)), upright=True)


@dataclass(frozen=True)
class AliasedGenerator(_Building):
    """Identical rooms, equally spaced on both sides of a corridor. Only the ends of the corridor distinguish them."""

    rooms: int = 10
    room_width: Limits = (3.6, 4.4)  # [m] along the corridor
    room_depth: Limits = (4.4, 5.2)  # [m]
    contents: Contents = field(default_factory=lambda: Contents(pilasters=0.06, pillars=0.7))

    def __call__(self, rng: np.random.Generator) -> FloorPlan:
        draft = Draft(rng, self.contents)
        bay = _draw_bay(rng, draw(rng, self.room_width), self.room_depth, self.door_width)
        above = (self.rooms + 1) // 2
        corridor = draw(rng, self.corridor_width)
        rows = [[bay] * count for count in (above, self.rooms - above) if count]
        placed = _lay_out(draft, rows, corridor, self.wall_thickness)
        draft.furnish(draft.rooms[placed[0][0]])
        self._repeat(draft, placed, corridor, bay.width + self.wall_thickness)
        return draft.finish("aliased")

    def _repeat(self, draft: Draft, placed: list[list[str]], corridor: float, pitch: float) -> None:
        """Copy the contents of the first room to all others."""
        blocked, pillars, furniture = list(draft.blocked), list(draft.pillars), list(draft.furniture)
        for side, row in enumerate(placed):
            y0, sign = side * corridor, 1.0 - 2.0 * side
            for i in range(side == 0, len(row)):
                shift = i * pitch
                for x1, y1, x2, y2 in blocked:
                    draft.blocked.append(_sided(side, corridor, round(x1 + shift, 3), y1, round(x2 + shift, 3), y2))
                draft.pillars += [(round(x + shift, 3), round(y0 + sign * y, 3), size) for x, y, size in pillars]
                draft.furniture += [
                    (round(x + shift, 3), round(y0 + sign * y, 3), length, width, sign * heading)
                    for x, y, length, width, heading in furniture
                ]


@dataclass(frozen=True)
class HallGenerator:
    """One large room with irregularly placed pillars."""

    length: Limits = (18.0, 22.0)  # [m]
    width: Limits = (18.0, 22.0)  # [m]
    contents: Contents = field(
        default_factory=lambda: Contents(pilasters=0.06, pillars=42, pillar_diameter=(0.25, 0.8), furniture=3)
    )

    def __post_init__(self) -> None:
        check_limits(self, 2.0, 500.0, "length", "width")

    def __call__(self, rng: np.random.Generator) -> FloorPlan:
        draft = Draft(rng, self.contents)
        draft.add_room("hall", Rectangle(0.0, 0.0, draw(rng, self.length), draw(rng, self.width)))
        draft.furnish(draft.rooms["hall"])
        return draft.finish("hall")


@dataclass(frozen=True)
class LoopGenerator:
    """A corridor round a block, with a few pilasters. A robot sees its start again only after the whole round."""

    length: Limits = (18.0, 22.0)  # [m] outside
    width: Limits = (13.0, 16.0)  # [m] outside
    corridor_width: Limits = (1.8, 2.4)  # [m]
    contents: Contents = field(default_factory=lambda: Contents(pilasters=0.1, pillars=0.0, furniture=0.0))

    def __post_init__(self) -> None:
        check_limits(self, 1.5, 20.0, "corridor_width")
        # a block as wide as a corridor is left in the middle
        check_limits(self, 3.0 * self.corridor_width[1], 500.0, "length", "width")

    def __call__(self, rng: np.random.Generator) -> FloorPlan:
        draft = Draft(rng, self.contents)
        x, y, corridor = draw(rng, self.length), draw(rng, self.width), draw(rng, self.corridor_width)
        low_x, low_y = round(x - corridor, 3), round(y - corridor, 3)
        sides = ((0.0, 0.0, x, corridor), (low_x, 0.0, x, y), (0.0, low_y, x, y), (0.0, 0.0, corridor, y))
        for name, side in zip(("south", "east", "north", "west"), sides):
            draft.add_room(name, Rectangle(*side))
        for u in (corridor / 2, x - corridor / 2):  # corners are kept free, where two corridors meet
            draft.kept_free += [(u, v, 0.75 * corridor) for v in (corridor / 2, y - corridor / 2)]
        for floor in draft.rooms.values():
            draft.furnish(floor)
        return draft.finish("loop")
