"""From a mask of free pixels to the walls around it and the point features on them. Needs the extra `maps`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_gym.types import Array, IntArray
from slam_gym.world.floor_plan import FloorPlanError

_MAX_WORK = 10_000**2  # sum of the squares of the vertices of all rings, which `straightened` takes a time like

Mask = NDArray[np.uint8]  # (h, w), 0 or 1

_EXTENT = 0.4  # [m] how far before and after a corner its walls are looked at
_TURN = np.deg2rad(40.0)  # smallest change of direction at a corner
_APART = 0.3  # [m] between two corners
_PILLAR = (0.15, 1.0)  # [m] an island of this diameter is a pillar; a smaller one is noise, a larger one has corners


def import_cv2() -> Any:
    """OpenCV, or ImportError naming the extra that brings it."""
    try:
        import cv2
    except ImportError as error:
        raise ImportError('floor plans from images need OpenCV: pip install "slam_gym[maps]"') from error
    return cv2


@dataclass(frozen=True)
class Outlines:
    """The simplified outlines of a free region, in pixels: x to the right, y down from the image's upper edge."""

    rings: list[Array]  # each (p, 2), closed implicitly, without straight-through vertices
    pillars: Array  # (k, 3) x, y of the centre and diameter of small islands; their rings are among `rings`
    is_pillar: list[bool]  # per ring


def trace(mask: Mask, pixel: float, tolerance: float) -> Outlines:
    """Outlines of `mask` along the edges of its pixels of side `pixel` [m], simplified by at most `tolerance` [pixels].

    The mask is traced on a lattice of twice its density, on which the edges between free and blocked pixels are nodes
    of their own: passages keep their full width. Simplification is Douglas and Peucker's (1973).
    """
    cv2 = import_cv2()
    lattice = np.zeros((2 * mask.shape[0] + 1, 2 * mask.shape[1] + 1), dtype=np.uint8)
    lattice[1::2, 1::2] = mask
    lattice = cv2.dilate(lattice, np.ones((3, 3), np.uint8))
    found, hierarchy = cv2.findContours(lattice, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    rings, pillars, is_pillar = [], [], []
    left = _MAX_WORK
    for contour, (_, _, _, parent) in zip(found, hierarchy[0] if len(found) else []):
        (x, y), radius = cv2.minEnclosingCircle(contour) if parent >= 0 else ((0.0, 0.0), np.inf)
        diameter = radius * pixel  # a lattice step is half a pixel, so radius in steps = diameter in pixels
        if diameter < _PILLAR[0]:
            continue
        contour = cv2.approxPolyDP(_with_corners(contour[:, 0], lattice)[:, None], 2.0 * tolerance, True)
        left -= len(contour) ** 2
        if left < 0:
            raise FloorPlanError("occupancy", "its outlines have too many corners: noise is no floor")
        ring = straightened(contour[:, 0] / 2.0)
        if len(ring) < 3:
            continue
        rings.append(ring)
        is_pillar.append(bool(diameter <= _PILLAR[1]))
        if is_pillar[-1]:
            pillars.append((x / 2.0, y / 2.0, radius))
    return Outlines(rings, np.array(pillars, dtype=np.float64).reshape(-1, 3), is_pillar)


def _with_corners(contour: NDArray[np.int32], lattice: Mask) -> NDArray[np.int32]:
    """The contour (n, 2) with the node put back at every corner that the tracing cuts by a diagonal step."""
    following = np.roll(contour, -1, axis=0)
    cut = np.flatnonzero((contour != following).all(axis=1))
    one = np.stack([contour[cut, 0], following[cut, 1]], axis=1)
    other = np.stack([following[cut, 0], contour[cut, 1]], axis=1)
    inside = lattice[one[:, 1], one[:, 0]] > 0
    return np.insert(contour, cut + 1, np.where(inside[:, None], one, other), axis=0)


def straightened(ring: Array) -> Array:
    """The ring (p, 2) without vertices at which it hardly turns or turns back on itself."""
    while len(ring) >= 3:
        before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        off = np.abs(cross) / np.maximum(np.hypot(*(before + after).T), 1e-9)  # distance from its neighbours' chord
        worst = int(np.argmin(off))
        if off[worst] > 0.25:
            break
        ring = np.delete(ring, worst, axis=0)
    return ring


def corners(ring: Array) -> tuple[Array, Array]:
    """The corners (c, 2) of a ring (p, 2) [m], and for each the shorter [m] of the edges that meet there, (c,).

    A corner is a vertex at which the direction over the last 0.4 m and that over the next differ by 40° or more: the
    ends of thin walls count and small steps do not. Of corners closer than 0.3 m the sharper stays.
    """
    edges = np.hypot(*(np.roll(ring, -1, axis=0) - ring).T)
    length = float(edges.sum())
    if length < 4 * _EXTENT:
        return np.zeros((0, 2)), np.zeros(0)
    at = np.concatenate([[0.0], np.cumsum(edges)])
    closed = np.vstack([ring, ring[:1]])

    def along(s: Array) -> Array:
        s = np.mod(s, length)
        return np.stack([np.interp(s, at, closed[:, 0]), np.interp(s, at, closed[:, 1])], axis=1)

    before, after = ring - along(at[:-1] - _EXTENT), along(at[:-1] + _EXTENT) - ring
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turn = np.abs(np.arctan2(cross, np.sum(before * after, axis=1)))
    sharp = np.flatnonzero(turn >= _TURN)
    kept = thinned(ring[sharp], turn[sharp])
    return ring[sharp][kept], np.minimum(edges, np.roll(edges, 1))[sharp][kept]


def thinned(points: Array, weights: Array, apart: float = _APART) -> IntArray:
    """Indices of `points` (n, 2) [m], heaviest first kept, so that no two are closer than `apart`, in their order."""
    from scipy.spatial import cKDTree

    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    near = cKDTree(points).query_ball_point(points, apart * (1.0 - 1e-9))
    dropped = np.zeros(len(points), dtype=bool)
    for i in np.argsort(-weights, kind="stable"):
        if not dropped[i]:
            dropped[near[i]] = True
            dropped[i] = False
            near[i] = []
    return np.flatnonzero(~dropped)
