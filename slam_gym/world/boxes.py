"""Furniture as oriented boxes (f, 5): `x m, y m, length m, width m, heading rad`, the centre first."""

from __future__ import annotations

import math

import numpy as np

from slam_gym._compile import compiled
from slam_gym.types import Array


@compiled
def outlines(boxes: Array) -> Array:
    """Sides (4f, 4) [m] `x1 y1 x2 y2` of boxes (f, 5), counter-clockwise."""
    sides = np.empty((4 * boxes.shape[0], 4))
    for f in range(boxes.shape[0]):
        c, s = math.cos(boxes[f, 4]), math.sin(boxes[f, 4])
        for k in range(4):
            a = 0.5 * boxes[f, 2] * (1.0 if k == 0 or k == 3 else -1.0)
            b = 0.5 * boxes[f, 3] * (1.0 if k < 2 else -1.0)
            x, y = boxes[f, 0] + c * a - s * b, boxes[f, 1] + s * a + c * b
            sides[4 * f + k, 0], sides[4 * f + k, 1] = x, y
            sides[4 * f + (k + 3) % 4, 2], sides[4 * f + (k + 3) % 4, 3] = x, y
    return sides


@compiled
def distance(x: float, y: float, boxes: Array) -> float:
    """[m] from a point to the nearest of boxes (f, 5), 0 within one; inf where there are none."""
    nearest = math.inf
    for f in range(boxes.shape[0]):
        dx, dy = x - boxes[f, 0], y - boxes[f, 1]
        c, s = math.cos(boxes[f, 4]), math.sin(boxes[f, 4])
        along = max(abs(c * dx + s * dy) - 0.5 * boxes[f, 2], 0.0)
        across = max(abs(c * dy - s * dx) - 0.5 * boxes[f, 3], 0.0)
        nearest = min(nearest, math.hypot(along, across))
    return nearest
