"""Floor plans from occupancy grids: real buildings as worlds. Needs the extra `maps`.

Images are grey: dark = wall, light = free; levels between (such as a ROS map's 205) are unknown and count as wall. Row
0 is the upper edge, so y = (h − row) · resolution.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from slam_gym.types import Array, IntArray
from slam_gym.world.draft import MAX_CORNER_SIZE
from slam_gym.world.floor_plan import MAX_EXTENT, MAX_PIXELS, Door, Features, FloorPlan, FloorPlanError, Kind, Room

try:
    cv2: Any = importlib.import_module("cv2")
except ImportError as error:
    raise ImportError('floor plans from images need OpenCV: pip install "slam_gym[maps]"') from error

FREE_ABOVE = 229  # grey level: lighter pixels are free; halfway between a ROS map's unknown (205) and free (254)
_PASSAGE = 1.0  # [m] deepest doorway: unlabelled free pixels between two labelled ones
_OPENING = 0.5  # [m] passages and spikes narrower than this are closed in maps without labels
_MIN_ROOM = 1.0  # [m²]
_SPECK = 0.05  # [m²] smaller obstacles in maps without labels are noise
_MIN_FLOOR = 4.0  # [m²] an enclosed part of at least this area is a floor,
_MAIN_PART = 0.05  # if it is at least this fraction of the largest part of all
_DRAWN, _MEASURED = 0.8, 1.25  # [pixels] tolerance of simplified outlines in maps with and without labels
_MIN_DOOR = 0.3  # [m]
_MAX_DOOR = 3.0  # [m] rooms that meet along more than this are open to each other
_MAX_OPENING = 1.2e10  # pixels of an image times pixels of the square by which it is opened
_MAX_ROOMS = 2_000
_JAMB_REACH = 0.4  # [m] from the end of a door line to the corners that frame it
_EXTENT = 0.4  # [m] length of wall before and after a corner over which its turn is measured
_TURN = np.deg2rad(40.0)  # smallest change of direction at a corner
_MIN_DISTANCE = 0.3  # [m] between two corners
_PILLAR = (0.15, 1.0)  # [m] an island of this diameter is a pillar; a smaller one is noise, a larger one has corners
_MAX_WORK = 10_000**2  # sum over all rings of their squared numbers of vertices, the cost of `straightened`

Mask = NDArray[np.uint8]  # (h, w), 0 or 1


def from_raster(
    occupancy: NDArray[Any],
    resolution: float,
    *,
    valid: NDArray[Any] | None = None,
    name: str = "raster",
    origin: tuple[float, float] = (0.0, 0.0),
) -> FloorPlan:
    """A floor plan from an image `occupancy` (h, w), uint8 (0 wall … 255 free) or bool (True free).

    `resolution` [m/pixel]; `valid` (h, w) integer room labels, 0 = wall or outside; `origin` [m] W of the lower left
    corner. With labels, free = occupancy ∩ (labelled ∪ doorways), a doorway being a straight run of unlabelled free
    pixels, at most 1 m long, from one labelled pixel to another. Without labels, everything narrower than 0.5 m is
    closed, and there is one room: the largest free part that does not touch the image's border, or, if no such part has
    4 m², the largest of all. Raises FloorPlanError, naming the field at fault.
    """
    occupancy = _checked(occupancy, resolution, valid)
    free = (occupancy > FREE_ABOVE).astype(np.uint8)
    if valid is not None:
        labelled = valid > 0
        free = _largest(free & (labelled | _doorways(free, labelled, max(1, round(_PASSAGE / resolution)))))
    else:
        free = _enclosed(free, resolution)
    if not free.any():
        narrow = f"wider than 0.5 m is lighter than {FREE_ABOVE} (the lightest pixel is {int(occupancy.max())})"
        raise FloorPlanError("occupancy", f"no free space: no part of a floor {narrow}; is the resolution right?")
    outlines = trace(free, resolution, _MEASURED) if valid is None else _trace_drawn(free, resolution)
    if not outlines:
        raise FloorPlanError("occupancy", "no free space: its floor is a single pixel; is the resolution right?")
    frame = _Frame(free.shape[0], resolution, origin)
    rings = [frame(outline.ring) for outline in outlines]
    rooms, doors = ((_keyhole("floor", rings),), ()) if valid is None else _rooms_and_doors(free, valid, frame)
    walls = np.vstack([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in rings])
    return FloorPlan(name, walls, _features(outlines, doors, frame), rooms, doors)


@dataclass(frozen=True)
class _Frame:
    """The transformation from pixels of an image to W."""

    height: int  # [pixel]
    resolution: float  # [m/pixel]
    origin: tuple[float, float]  # [m] W of the lower left corner

    def __call__(self, points: Array) -> Array:
        """Points (n, 2) [m] W of `points` (n, 2) [pixel], x to the right and y down from the upper edge."""
        flipped = np.stack([points[:, 0], self.height - points[:, 1]], axis=1)
        return np.asarray(np.round(self.origin + self.resolution * flipped, 4))


def _checked(occupancy: NDArray[Any], resolution: float, valid: NDArray[Any] | None) -> NDArray[np.uint8]:
    if not isinstance(resolution, int | float | np.number) or not 1e-3 <= resolution <= 1.0:
        raise FloorPlanError("resolution", f"{resolution!r} is not in [0.001, 1] metres per pixel")
    if occupancy.ndim != 2 or min(occupancy.shape) < 3:
        raise FloorPlanError("occupancy", f"has shape {occupancy.shape}, expected (h, w) of at least 3 × 3 pixels")
    if occupancy.dtype != np.uint8 and occupancy.dtype != np.bool_:
        raise FloorPlanError("occupancy", f"holds {occupancy.dtype}, expected uint8 or bool")
    if max(occupancy.shape) * resolution > MAX_EXTENT:
        raise FloorPlanError("resolution", f"makes the plan longer than {MAX_EXTENT:g} m")
    if occupancy.size > MAX_PIXELS:
        raise FloorPlanError("occupancy", f"has more than {MAX_PIXELS >> 20} million pixels: scale it down")
    width = _OPENING / resolution  # [pixels], by most of which the image is padded
    if valid is None and math.prod(size + 1.5 * width for size in occupancy.shape) * width**2 > _MAX_OPENING:
        raise FloorPlanError("resolution", "is too fine for so many pixels: scale the image down, or correct it")
    if valid is not None and (valid.shape != occupancy.shape or valid.dtype.kind not in "iu"):
        raise FloorPlanError("valid", f"{valid.dtype} {valid.shape}: expected integers {occupancy.shape}")
    return occupancy.astype(np.uint8) * np.uint8(255) if occupancy.dtype == np.bool_ else occupancy


def _largest(free: Mask) -> Mask:
    """The largest 4-connected part of `free`."""
    count, parts, stats, _ = cv2.connectedComponentsWithStats(free, connectivity=4)
    return np.asarray(parts == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA]), np.uint8) if count > 1 else free


def _doorways(free: Mask, labelled: NDArray[np.bool_], longest: int) -> NDArray[np.bool_]:
    """(h, w) the straight runs of at most `longest` unlabelled free pixels from one labelled pixel to another."""
    gaps = (free > 0) & ~labelled
    return _bridged(gaps, labelled, longest) | _bridged(gaps.T, labelled.T, longest).T


def _bridged(gaps: NDArray[np.bool_], labelled: NDArray[np.bool_], longest: int) -> NDArray[np.bool_]:
    """(h, w) the runs of at most `longest` gaps along a row that begin and end beside labelled pixels."""
    run, count = ndimage.label(gaps, [[0, 0, 0], [1, 1, 1], [0, 0, 0]])  # number of the run of each gap, or 0
    begins, ends = np.zeros(count + 1, np.bool_), np.zeros(count + 1, np.bool_)
    begins[run[:, 1:][gaps[:, 1:] & labelled[:, :-1]]] = True
    ends[run[:, :-1][gaps[:, :-1] & labelled[:, 1:]]] = True
    fits = begins & ends & (np.bincount(run[gaps], minlength=count + 1) <= longest)
    return np.asarray(fits[run])


def _enclosed(free: Mask, resolution: float) -> Mask:
    """The floor in a map without labels: specks are filled, spikes cut, and free space outside is dropped.

    Of the parts that do not touch the border the largest is kept; where all of them are small, the largest of all.
    """
    _, parts, stats, _ = cv2.connectedComponentsWithStats(1 - free, connectivity=8)
    speck = stats[:, cv2.CC_STAT_AREA] * resolution**2 < _SPECK
    speck[0] = False  # component 0 is free space
    free = free | speck[parts].astype(np.uint8)
    free = _opened(free, _OPENING / resolution)
    _, parts, stats, _ = cv2.connectedComponentsWithStats(free, connectivity=4)
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    border = np.unique(np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]]))
    inner = areas.copy()
    inner[border] = 0
    if inner.max() * resolution**2 >= _MIN_FLOOR and inner.max() >= _MAIN_PART * areas.max():
        areas = inner
    return _opened(np.asarray((parts == np.argmax(areas)) & (free > 0), np.uint8), _OPENING / resolution, one_part=True)


def _opened(free: Mask, width: float, one_part: bool = False) -> Mask:
    """The opening of `free` by a square of `width` [pixels] in four orientations, so that corners stay sharp.

    With `one_part`, the square's centre stays in the largest connected part of the places where it fits.
    """
    reach = max(1, round(0.75 * width))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    turned = [(np.cos(angle), np.sin(angle)) for angle in np.arange(4) * np.pi / 8]
    squares = [np.maximum(np.abs(c * x + s * y), np.abs(c * y - s * x)) <= width / 2 for c, s in turned]
    kernels = [square.astype(np.uint8) for square in squares]
    centres = [cv2.erode(np.pad(free, reach), kernel) for kernel in kernels]
    part = np.bitwise_or.reduce(centres)
    if one_part:
        part = _largest(part)
    covered = [cv2.dilate(centre & part, kernel) for centre, kernel in zip(centres, kernels)]
    return np.asarray(np.bitwise_or.reduce(covered)[reach:-reach, reach:-reach])


def _keyhole(name: str, rings: list[Array]) -> Room:
    """The room within the largest of the outlines `rings`, each (p, 2) [m], without what the others enclose.

    Its polygon goes from a corner to each of these, round it, and back.
    """
    outer, *inner = sorted(rings, key=lambda ring: -Room(name, ring).area)
    # of these, OpenCV traces the inner ones the other way, so that areas are right
    return Room(name, np.vstack([outer, *(part for ring in inner for part in (outer[:1], ring, ring[:1]))]))


def _rooms_and_doors(free: Mask, valid: NDArray[Any], frame: _Frame) -> tuple[tuple[Room, ...], tuple[Door, ...]]:
    """One room per connected part of a label, and a door wherever two rooms meet along a short line."""
    labels, compact = np.unique(np.where(free > 0, valid, 0), return_inverse=True)
    compact = compact.reshape(valid.shape)
    rooms: list[Room] = []
    index = np.zeros(free.shape, dtype=np.int32)  # 1 + room of each pixel
    if len(labels) > _MAX_ROOMS:
        raise FloorPlanError("valid", f"holds more than {_MAX_ROOMS} labels")
    for label, box in zip(labels, ndimage.find_objects(compact + 1)):
        if label == 0:
            continue
        labelled = (valid[box] == label).astype(np.uint8) & free[box]
        _, parts, stats, _ = cv2.connectedComponentsWithStats(labelled, connectivity=4)
        offset = np.array([box[1].start, box[0].start])
        for part in 1 + np.flatnonzero(stats[1:, cv2.CC_STAT_AREA] * frame.resolution**2 >= _MIN_ROOM):
            outlines = _trace_drawn((parts == part).astype(np.uint8), frame.resolution)
            if not outlines:  # a room of a few large pixels
                continue
            name = f"room {label}" if all(room.name != f"room {label}" for room in rooms) else f"room {label}.{part}"
            rooms.append(_keyhole(name, [frame(outline.ring + offset) for outline in outlines]))
            index[box][parts == part] = len(rooms)
    if not rooms:
        raise FloorPlanError("valid", f"labels no free room of at least {_MIN_ROOM:g} m²")
    return tuple(rooms), _doors(_spread(index) * (free > 0), rooms, frame)


def _spread(index: NDArray[np.int32]) -> NDArray[np.int32]:
    """`index` (h, w) with every pixel without a room assigned to the nearest room."""
    without_room = (index == 0).astype(np.uint8)
    _, nearest = cv2.distanceTransformWithLabels(without_room, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    room_of = np.zeros(int(nearest.max()) + 1, dtype=np.int32)
    room_of[nearest[index > 0]] = index[index > 0]
    return np.asarray(room_of[nearest])


def _doors(index: NDArray[np.int32], rooms: list[Room], frame: _Frame) -> tuple[Door, ...]:
    """The doors on the lines along which pixels of two rooms touch."""
    contacts = []  # x, y [pixel] of the middle between the two pixels, and the two rooms
    for dy, dx in ((0, 1), (1, 0)):
        a, b = index[: index.shape[0] - dy, : index.shape[1] - dx], index[dy:, dx:]
        y, x = np.nonzero((a != b) & (a > 0) & (b > 0))
        pair = np.sort(np.stack([a[y, x], b[y, x]], axis=1), axis=1)
        contacts.append(np.column_stack([x + (1 + dx) / 2, y + (1 + dy) / 2, pair]))
    doors = []
    table = np.vstack(contacts)
    for a, b in np.unique(table[:, 2:], axis=0).astype(int):
        points = table[(table[:, 2] == a) & (table[:, 3] == b), :2]
        tree = cKDTree(points)
        near = tree.sparse_distance_matrix(tree, 2.5, output_type="coo_matrix")
        count, line = connected_components(near, directed=False)
        for part in range(count):
            ends = points[line == part]
            width = (float(np.hypot(*np.ptp(ends, axis=0))) + 1.0) * frame.resolution
            if _MIN_DOOR <= width <= _MAX_DOOR:
                middle = frame((ends.min(axis=0) + ends.max(axis=0))[None] / 2)[0]
                doors.append(Door(middle, round(width, 4), (rooms[a - 1].name, rooms[b - 1].name)))
    return tuple(doors)


def _features(outlines: list[Outline], doors: tuple[Door, ...], frame: _Frame) -> Features:
    """The features: corners of the walls, as door jambs where they frame a door, and small islands as pillars."""
    diameters = np.array([outline.diameter for outline in outlines]) * frame.resolution
    pillar = diameters <= _PILLAR[1]
    by_ring = [corners(frame(outline.ring)) for outline, is_pillar in zip(outlines, pillar) if not is_pillar]
    positions = np.vstack([np.zeros((0, 2)), *(position for position, _ in by_ring)])
    sizes = np.clip(np.concatenate([np.zeros(0), *(size for _, size in by_ring)]), frame.resolution, MAX_CORNER_SIZE)
    kinds = np.full(len(positions), int(Kind.CORNER))
    for door in doors:
        from_end = np.abs(np.hypot(*(positions - door.position).T) - door.width / 2)
        jamb = from_end < _JAMB_REACH
        kinds[jamb], sizes[jamb] = int(Kind.DOOR_JAMB), door.width
    kept = thinned(positions, kinds.astype(np.float64))
    centres = frame(np.array([outline.centre for outline in outlines]).reshape(-1, 2)[pillar])
    return Features(
        np.vstack([positions[kept], centres]),
        np.concatenate([kinds[kept], np.full(len(centres), int(Kind.PILLAR))]),
        np.round(np.concatenate([sizes[kept], diameters[pillar]]), 4),
    )


class Outline(NamedTuple):
    """A simplified outline of a free region, in pixels: x to the right, y down from the image's upper edge."""

    ring: Array  # (p, 2), closed implicitly, without straight-through vertices
    centre: tuple[float, float]  # of the smallest circle around an island
    diameter: float  # of that circle; infinite where free space is inside the ring


def trace(mask: Mask, pixel: float, tolerance: float) -> list[Outline]:
    """Outlines of `mask` along the edges of its pixels of side `pixel` [m], simplified by at most `tolerance` [pixels].

    The mask is traced on a lattice of twice its density, in which edges between free and blocked pixels are nodes, so
    that passages keep their full width. Simplification is by the algorithm of Douglas and Peucker (1973).
    """
    lattice = np.zeros((2 * mask.shape[0] + 1, 2 * mask.shape[1] + 1), dtype=np.uint8)
    lattice[1::2, 1::2] = _without_gaps(mask)
    lattice = cv2.dilate(lattice, np.ones((3, 3), np.uint8))
    contours, hierarchy = cv2.findContours(lattice, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outlines = []
    work_left = _MAX_WORK
    for contour, (_, _, _, parent) in zip(contours, hierarchy[0] if len(contours) else []):
        (x, y), radius = cv2.minEnclosingCircle(contour) if parent >= 0 else ((0.0, 0.0), np.inf)
        diameter = radius  # in pixels, since a lattice step is half a pixel
        if diameter * pixel < _PILLAR[0]:
            continue
        contour = cv2.approxPolyDP(_with_corners(contour[:, 0], lattice)[:, None], 2.0 * tolerance, True)
        work_left -= len(contour) ** 2
        if work_left < 0:
            raise FloorPlanError("occupancy", "its outlines have too many corners: noise is no floor")
        ring = straightened(contour[:, 0] / 2.0)
        if len(ring) >= 3:
            outlines.append(Outline(ring, (x / 2.0, y / 2.0), diameter))
    return outlines


def _trace_drawn(mask: Mask, pixel: float) -> list[Outline]:
    """The outlines of a drawing: to less than a pixel, unless walls that run across the pixels have too many stairs."""
    try:
        return trace(mask, pixel, _DRAWN)
    except FloorPlanError:
        return trace(mask, pixel, _MEASURED)


def _without_gaps(mask: Mask) -> Mask:
    """`mask` (h, w) without the gaps of oblique walls that are one pixel thick: of two free pixels that touch only
    diagonally, between two that are not free, the upper one becomes wall."""
    mask = mask.copy()
    while True:
        a, b, c, d = mask[:-1, :-1] > 0, mask[:-1, 1:] > 0, mask[1:, :-1] > 0, mask[1:, 1:] > 0
        falling, rising = a & d & ~b & ~c, b & c & ~a & ~d
        if not (falling | rising).any():
            return mask
        mask[:-1, :-1][falling] = 0
        mask[:-1, 1:][rising] = 0


def _with_corners(contour: NDArray[np.int32], lattice: Mask) -> NDArray[np.int32]:
    """`contour` (n, 2) with a node inserted at every corner that the tracing cuts by a diagonal step."""
    following = np.roll(contour, -1, axis=0)
    cut = np.flatnonzero((contour != following).all(axis=1))
    one = np.stack([contour[cut, 0], following[cut, 1]], axis=1)
    other = np.stack([following[cut, 0], contour[cut, 1]], axis=1)
    inside = lattice[one[:, 1], one[:, 0]] > 0
    return np.insert(contour, cut + 1, np.where(inside[:, None], one, other), axis=0)


def straightened(ring: Array) -> Array:
    """`ring` (p, 2) [pixels] without vertices at which it hardly turns or turns back on itself."""
    while len(ring) >= 3:
        before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        distances = np.abs(cross) / np.maximum(np.hypot(*(before + after).T), 1e-9)  # from the neighbours' chord
        flattest = int(np.argmin(distances))
        if distances[flattest] > 0.25:
            break
        ring = np.delete(ring, flattest, axis=0)
    return ring


def corners(ring: Array) -> tuple[Array, Array]:
    """The corners (c, 2) [m] of `ring` (p, 2) [m], and (c,) [m] the shorter of the edges that meet at each.

    A corner is a vertex at which the directions over the last and the next 0.4 m differ by 40° or more, so that the
    ends of thin walls count and small steps do not. Of corners closer than 0.3 m, the sharpest remains.
    """
    edges = np.hypot(*(np.roll(ring, -1, axis=0) - ring).T)
    length = float(edges.sum())
    if length < 4 * _EXTENT:
        return np.zeros((0, 2)), np.zeros(0)
    lengths = np.concatenate([[0.0], np.cumsum(edges)])  # along the ring, up to each vertex
    closed = np.vstack([ring, ring[:1]])

    def along(s: Array) -> Array:
        s = np.mod(s, length)
        return np.stack([np.interp(s, lengths, closed[:, 0]), np.interp(s, lengths, closed[:, 1])], axis=1)

    before, after = ring - along(lengths[:-1] - _EXTENT), along(lengths[:-1] + _EXTENT) - ring
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turn = np.abs(np.arctan2(cross, np.sum(before * after, axis=1)))
    sharp = np.flatnonzero(turn >= _TURN)
    kept = thinned(ring[sharp], turn[sharp])
    return ring[sharp][kept], np.minimum(edges, np.roll(edges, 1))[sharp][kept]


def thinned(points: Array, weights: Array) -> IntArray:
    """Indices, in order, of `points` (n, 2) [m] chosen by falling weight so that no two are closer than 0.3 m."""
    near = cKDTree(points).query_ball_point(points, _MIN_DISTANCE * (1.0 - 1e-9))
    dropped = np.zeros(len(points), dtype=bool)
    for i in np.argsort(-weights, kind="stable"):
        if not dropped[i]:
            dropped[near[i]] = True
            dropped[i] = False
            near[i] = []
    return np.flatnonzero(~dropped)
