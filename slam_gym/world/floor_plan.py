"""FloorPlan: walls, point features, rooms, doors, furniture. Pure data in the world frame W.

A plan is checked when it is built: its numbers are finite, its sizes are within limits, and all references resolve.
"""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.types import Array, BoolArray, IntArray

MAX_EXTENT = 2_000.0  # [m] longest side of a plan, and farthest coordinate from the origin
MAX_PIXELS = 1 << 24  # in an image that becomes a plan: 200 m × 200 m at 5 cm
MAX_SIZE = 100.0  # [m] largest feature, door or piece of furniture
_SAME_POINT = 1e-3  # [m] features closer than this are one feature


class FloorPlanError(ValueError):
    """An invalid floor plan: names the field, the reason and, for a plan read from a file, the file."""

    def __init__(self, field: str, reason: str, file: str | None = None) -> None:
        super().__init__(field, reason, file)
        self.field, self.reason, self.file = field, reason, file

    def __str__(self) -> str:
        return ": ".join(part for part in (self.file, self.field, self.reason) if part)


class Kind(IntEnum):
    """What a point feature is."""

    CORNER = 0  # where two wall faces meet
    DOOR_JAMB = 1  # a corner that frames a door
    PILLAR = 2  # the centre of a free-standing column


def checked_array(field: str, value: ArrayLike, *columns: int) -> Array:
    """`value` as a new float64 array (rows, *columns). Raises FloorPlanError unless it is finite and has that shape."""
    try:
        raw = np.array(value)
    except ValueError:  # rows of different lengths
        raise FloorPlanError(field, "is not a table of numbers") from None
    if raw.ndim and len(raw) == 0:
        return np.zeros((0, *columns))
    if raw.dtype.kind not in "iuf":
        raise FloorPlanError(field, "is not a table of numbers")
    array = np.array(raw, dtype=np.float64, order="C")
    if array.ndim != 1 + len(columns) or array.shape[1:] != columns:
        raise FloorPlanError(field, f"has shape {array.shape}, expected ({', '.join(map(str, ('n', *columns)))})")
    _refuse(field, ~np.isfinite(array.reshape(len(array), -1)).all(axis=1), "is not finite")
    return array


def _refuse(field: str, bad: ArrayLike, reason: str) -> None:
    """Raise FloorPlanError, naming the first row where `bad` (n,) holds, if any."""
    if np.any(bad):
        raise FloorPlanError(f"{field}[{int(np.argmax(bad))}]", reason)


def _refuse_sizes(field: str, sizes: Array) -> None:
    _refuse(field, ~(sizes > 0.0) | (sizes > MAX_SIZE), f"is not in (0, {MAX_SIZE:g}] m")


@dataclass(frozen=True, eq=False)
class Features:
    """The point features that a sensor may see, in any order; the index of a feature identifies it."""

    positions: Array  # (N, 2) [m] W
    kinds: IntArray  # (N,) values of `Kind`
    sizes: Array  # (N,) [m] the intrinsic attribute: diameter of a pillar, width of a jamb's door, wall at a corner

    def __post_init__(self) -> None:
        positions = checked_array("features.positions", self.positions, 2)
        sizes = checked_array("features.sizes", self.sizes)
        kinds = checked_array("features.kinds", self.kinds)
        if not len(positions) == len(kinds) == len(sizes):
            raise FloorPlanError("features", f"{len(positions)} positions, {len(kinds)} kinds, {len(sizes)} sizes")
        _refuse("features.kinds", ~np.isin(kinds, [kind.value for kind in Kind]), "is no known kind")
        _refuse_sizes("features.sizes", sizes)
        _, first = np.unique(np.round(positions / _SAME_POINT), axis=0, return_index=True)
        _refuse("features.positions", ~np.isin(np.arange(len(positions)), first), "repeats another feature's position")
        _set(self, positions=positions, kinds=kinds.astype(np.int64), sizes=sizes)

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True, eq=False)
class Room:
    """A named region of the plan. Its outline is closed implicitly and may run in either direction."""

    name: str
    polygon: Array  # (p, 2) [m] W

    def __post_init__(self) -> None:
        _set(self, polygon=checked_array(f"room {self.name!r}: polygon", self.polygon, 2))
        if len(self.polygon) < 3 or self.area < 1e-3:
            raise FloorPlanError(f"room {self.name!r}: polygon", "encloses no area")

    @cached_property
    def area(self) -> float:
        """[m²], by the shoelace formula."""
        x, y = (self.polygon - self.polygon[0]).T
        return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))

    def contains(self, points: Array) -> BoolArray:
        """Which of `points` (m, 2) [m] lie inside: a ray to the right crosses the outline an odd number of times."""
        inside = np.zeros(len(points), dtype=bool)
        low, high = self.polygon.min(axis=0), self.polygon.max(axis=0)
        near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        x, y = points[near].T
        odd = np.zeros(len(near), dtype=bool)
        for (x1, y1), (x2, y2) in zip(self.polygon, np.roll(self.polygon, -1, axis=0)):
            if y1 != y2:
                odd ^= ((y1 > y) != (y2 > y)) & (x < x1 + (y - y1) * (x2 - x1) / (y2 - y1))
        inside[near] = odd
        return inside


@dataclass(frozen=True, eq=False)
class Door:
    """An opening between two rooms."""

    position: Array  # (2,) [m] W, its middle
    width: float  # [m] clear
    rooms: tuple[str, str]  # names of the rooms that it joins

    def __post_init__(self) -> None:
        position = checked_array("door: position", [self.position], 2)[0]
        _refuse_sizes("door: width", checked_array("door: width", [self.width]))
        if len(self.rooms) != 2 or self.rooms[0] == self.rooms[1]:
            raise FloorPlanError("door: rooms", f"{self.rooms!r} are not two different rooms")
        _set(self, position=position, width=float(self.width), rooms=tuple(self.rooms))


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """One floor. Raises FloorPlanError, a ValueError that names the field, for an invalid plan."""

    name: str
    walls: Array  # (s, 4) [m] x₁ y₁ x₂ y₂ W
    features: Features
    rooms: tuple[Room, ...] = ()
    doors: tuple[Door, ...] = ()
    furniture: Array = ()  # type: ignore[assignment]  # (f, 5) [x m, y m, length m, width m, heading rad] at the start

    def __post_init__(self) -> None:
        walls, furniture = checked_array("walls", self.walls, 4), checked_array("furniture", self.furniture, 5)
        _set(self, walls=walls, furniture=furniture, rooms=tuple(self.rooms), doors=tuple(self.doors))
        if len(walls) == 0:
            raise FloorPlanError("walls", "there are none, so nothing encloses the floor")
        _refuse("walls", np.hypot(walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]) < 1e-6, "has no length")
        _refuse("walls", np.abs(walls).max(axis=1) > MAX_EXTENT, f"lies beyond {MAX_EXTENT:g} m from the origin")
        low, high = self.bounds[:2] - 1.0, self.bounds[2:] + 1.0
        if np.max(high - low) > MAX_EXTENT:
            raise FloorPlanError("walls", f"the plan is longer than {MAX_EXTENT:g} m")
        for sizes, side in zip(furniture[:, 2:4].T, ("length", "width")):
            _refuse_sizes(f"furniture.{side}", sizes)
        for field, points in (("features.positions", self.features.positions), ("furniture", furniture[:, :2])):
            _refuse(field, ((points < low) | (points > high)).any(axis=1), "lies outside of all walls")
        names = [room.name for room in self.rooms]
        _refuse("rooms", [name in names[:i] for i, name in enumerate(names)], "repeats a name")
        for i, door in enumerate(self.doors):
            if not set(names) >= set(door.rooms):
                raise FloorPlanError(f"doors[{i}].rooms", f"{door.rooms!r} names an unknown room")

    @cached_property
    def bounds(self) -> Array:
        """(4,) [m] x_min, y_min, x_max, y_max of the walls."""
        ends = self.walls.reshape(-1, 2)
        return np.concatenate([ends.min(axis=0), ends.max(axis=0)])


def _set(record: object, **fields: object) -> None:
    """Assign the checked values to fields of a frozen record that is still being built."""
    for name, value in fields.items():
        object.__setattr__(record, name, value)
