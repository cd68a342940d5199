"""SE(2): composition, inversion and transformation of points, each with its Jacobians; and rays through grids.

The notation is that of the stochastic-map literature. For a pose b given in the frame of a, a ⊕ b is b in the frame in
which a is given; ⊖a is the inverse of a. Poses are (3,) `[x m, y m, θ rad]`, points (2,) [m].
"""

import math
from collections.abc import Iterator

import numpy as np

from slam_gym._jit import compiled, compiled_generator
from slam_gym.types import Array


@compiled
def wrap_angle(angle: float) -> float:
    """`angle` [rad] wrapped to (−π, π]."""
    wrapped = (angle + math.pi) % (2.0 * math.pi)
    if wrapped <= 0.0:
        wrapped += 2.0 * math.pi
    return wrapped - math.pi


def wrap_angles(angles: Array) -> Array:
    """Angles [rad] of any shape wrapped to (−π, π]."""
    return np.asarray(math.pi - np.remainder(math.pi - angles, 2.0 * math.pi))


@compiled
def compose(a: Array, b: Array) -> Array:
    """a ⊕ b for two poses (3,)."""
    c, s = math.cos(a[2]), math.sin(a[2])
    out = np.empty(3)
    out[0] = a[0] + c * b[0] - s * b[1]
    out[1] = a[1] + s * b[0] + c * b[1]
    out[2] = wrap_angle(a[2] + b[2])
    return out


def compose_jacobians(a: Array, b: Array) -> tuple[Array, Array]:
    """∂(a ⊕ b)/∂a and ∂(a ⊕ b)/∂b, each (3, 3)."""
    c, s = math.cos(a[2]), math.sin(a[2])
    ja, jb = np.eye(3), np.eye(3)
    ja[0, 2] = -s * b[0] - c * b[1]
    ja[1, 2] = c * b[0] - s * b[1]
    jb[0, 0], jb[0, 1] = c, -s
    jb[1, 0], jb[1, 1] = s, c
    return ja, jb


@compiled
def relative(a: Array, b: Array) -> Array:
    """⊖a ⊕ b: pose b in the frame of pose a, where both are given in one frame."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return compose(np.array([-c * a[0] - s * a[1], s * a[0] - c * a[1], wrap_angle(-a[2])]), b)


def inverse(a: Array) -> Array:
    """⊖a for a pose (3,)."""
    return relative(a, np.zeros(3))


@compiled
def transform(pose: Array, points: Array) -> Array:
    """Points (m, 2) given in the frame of `pose`, transformed to the frame in which `pose` is given, (m, 2)."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    out = np.empty_like(points)
    for i in range(points.shape[0]):
        out[i, 0] = pose[0] + c * points[i, 0] - s * points[i, 1]
        out[i, 1] = pose[1] + s * points[i, 0] + c * points[i, 1]
    return out


@compiled
def observe(pose: Array, points: Array) -> Array:
    """⊖pose ⊕ points: points (m, 2) of the outer frame, transformed to the frame of `pose`, (m, 2)."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    out = np.empty_like(points)
    for i in range(points.shape[0]):
        dx, dy = points[i, 0] - pose[0], points[i, 1] - pose[1]
        out[i, 0] = c * dx + s * dy
        out[i, 1] = -s * dx + c * dy
    return out


def rotate_covariances(heading: float, covariances: Array) -> Array:
    """C Σ Cᵀ for each covariance of (m, 2, 2), where C is the rotation by `heading` [rad]."""
    (xx, xy), (_, yy) = covariances.transpose(1, 2, 0)
    c, s = math.cos(heading), math.sin(heading)
    across = c * s * (xx - yy) + (c * c - s * s) * xy
    along_x, along_y = c * c * xx - 2.0 * c * s * xy + s * s * yy, s * s * xx + 2.0 * c * s * xy + c * c * yy
    return np.array([[along_x, across], [across, along_y]]).transpose(2, 0, 1)


@compiled_generator
def cells_along(x: float, y: float, dx: float, dy: float, reach: float) -> Iterator[tuple[int, int, float, float]]:
    """The cells of a grid that a ray from (x, y) [cells] crosses, in order (Amanatides and Woo, "A fast voxel traversal
    algorithm for ray tracing", 1987).

    Yields row, column, and the parameters t at which (x, y) + t (dx, dy) enters and leaves the cell, up to t = `reach`.
    """
    column, row, enter = math.floor(x), math.floor(y), 0.0
    step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_x = next_y = across_x = across_y = math.inf  # t at the next border, t from border to border
    if dx != 0.0:
        next_x, across_x = (column + (dx > 0.0) - x) / dx, 1.0 / abs(dx)
    if dy != 0.0:
        next_y, across_y = (row + (dy > 0.0) - y) / dy, 1.0 / abs(dy)
    while enter < reach:
        leave = min(next_x, next_y, reach)
        yield row, column, enter, leave
        enter = leave
        if next_x < next_y:
            column, next_x = column + step_x, next_x + across_x
        else:
            row, next_y = row + step_y, next_y + across_y
