"""Jacobians of points seen from poses, written out."""

import math

import numpy as np

from slam_gym.types import Array


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
