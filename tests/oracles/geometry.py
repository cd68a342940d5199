"""Jacobians of points seen from poses, written out, and of any function by finite differences."""

import math
from collections.abc import Callable

import numpy as np

from slam_gym.types import Array, IntArray


def numerical(f: Callable[[Array], Array], x: Array, wrapped: int | None = None, step: float = 1e-6) -> Array:
    """Jacobian of f at x by central differences; `wrapped` names the row that is an angle."""
    columns = []
    for e in step * np.eye(len(x)):
        difference = f(x + e) - f(x - e)
        if wrapped is not None:
            difference[wrapped] = math.remainder(difference[wrapped], 2.0 * math.pi)
        columns.append(difference / (2.0 * step))
    return np.column_stack(columns)


def rigid_motions(points: Array) -> Array:
    """(2k, 3) what moving and turning points (k, 2) about the origin, all together, does to them at first."""
    x, y = points.T
    out = np.zeros((2 * len(points), 3))
    out[0::2, 0] = out[1::2, 1] = 1.0
    out[0::2, 2], out[1::2, 2] = -y, x
    return out


def block_diagonal(blocks: Array) -> Array:
    """(2k, 2k) of blocks (k, 2, 2) on the diagonal."""
    each, out = np.arange(len(blocks)), np.zeros((len(blocks), 2, len(blocks), 2))
    out[each, :, each] = blocks
    return out.reshape(2 * len(blocks), 2 * len(blocks))


def differences(pairs: IntArray, n: int) -> Array:
    """H (2k, 2n): how far the second of each pair (k, 2) of n features lies from the first."""
    return np.kron(np.eye(n)[pairs[:, 1]] - np.eye(n)[pairs[:, 0]], np.eye(2))


def transform_jacobians(pose: Array, point: Array) -> tuple[Array, Array]:
    """∂(pose ⊕ point)/∂pose (2, 3) and /∂point (2, 2)."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    by_pose = np.array([[1.0, 0.0, -s * point[0] - c * point[1]], [0.0, 1.0, c * point[0] - s * point[1]]])
    return by_pose, np.array([[c, -s], [s, c]])


def observe_jacobians(pose: Array, point: Array) -> tuple[Array, Array]:
    """∂(⊖pose ⊕ point)/∂pose (2, 3) and /∂point (2, 2): the H of a point feature."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = point[0] - pose[0], point[1] - pose[1]
    return np.array([[-c, -s, -s * dx + c * dy], [s, -c, -c * dx - s * dy]]), np.array([[c, s], [-s, c]])
