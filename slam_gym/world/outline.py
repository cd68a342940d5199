"""The outline of a union of rectangles: exact, by coordinate compression."""

from __future__ import annotations

import numpy as np

from slam_gym.types import Array, BoolArray


def covered(rectangles: Array, xs: Array, ys: Array) -> BoolArray:
    """Which cells (len(ys) − 1, len(xs) − 1) of the grid xs × ys lie in one of `rectangles` (r, 4) x₁ y₁ x₂ y₂ [m]."""
    cells = np.zeros((len(ys) - 1, len(xs) - 1), dtype=bool)
    for x1, y1, x2, y2 in rectangles:
        (i1, i2), (j1, j2) = np.searchsorted(ys, (y1, y2)), np.searchsorted(xs, (x1, x2))
        cells[i1:i2, j1:j2] = True
    return cells


def _runs(edges: BoolArray, corners: BoolArray, at: Array) -> Array:
    """Maximal runs of wall along the grid lines, cut at corners: (s, 3) line, from, to [m].

    `edges` (lines, cells) says where a line separates free from blocked, `corners` (lines, cells + 1) where it turns.
    """
    runs = []
    for line, (edge, corner) in enumerate(zip(edges, corners)):
        joined = np.concatenate([[False], edge, [False]])
        starts = joined[1:] & (~joined[:-1] | corner)
        ends = joined[:-1] & (~joined[1:] | corner)
        runs += [(line, at[i], at[j]) for i, j in zip(np.flatnonzero(starts), np.flatnonzero(ends))]
    return np.array(runs, dtype=np.float64).reshape(-1, 3)


def outline(free: Array, blocked: Array) -> tuple[Array, Array, Array]:
    """Outline of ∪ `free` ∖ ∪ `blocked`, both rectangles (·, 4) x₁ y₁ x₂ y₂ [m].

    Returns walls (s, 4) [m], each from one corner to the next; corners (c, 2) [m], each once; and the length [m] of the
    shorter of the walls that meet at each corner, (c,). A grid point is a corner unless the free cells around it are
    none, all, or two side by side.
    """
    edges = np.vstack([free, blocked])
    xs, ys = np.unique(edges[:, 0::2]), np.unique(edges[:, 1::2])
    cells = np.pad(covered(free, xs, ys) & ~covered(blocked, xs, ys), 1)
    around = np.stack([cells[:-1, :-1], cells[:-1, 1:], cells[1:, 1:], cells[1:, :-1]]).astype(np.int64)
    count = around.sum(axis=0)
    corner = (count % 2 == 1) | ((count == 2) & (around[0] == around[2]))
    level = _runs((cells[:-1] != cells[1:])[:, 1:-1], corner, xs)
    upright = _runs((cells[:, :-1] != cells[:, 1:])[1:-1].T, corner.T, ys)
    rows, columns = level[:, 0].astype(int), upright[:, 0].astype(int)
    walls = np.vstack(
        [
            np.stack([level[:, 1], ys[rows], level[:, 2], ys[rows]], axis=1),
            np.stack([xs[columns], upright[:, 1], xs[columns], upright[:, 2]], axis=1),
        ]
    )
    i, j = np.nonzero(corner)
    corners = np.stack([xs[j], ys[i]], axis=1)
    lengths = np.abs(walls[:, 2:] - walls[:, :2]).sum(axis=1)
    touches = (corners[:, None, None, :] == walls.reshape(1, -1, 2, 2)).all(axis=-1).any(axis=-1)
    shorter: Array = np.where(touches, lengths, np.inf).min(axis=1, initial=np.inf)
    return walls, corners, shorter
