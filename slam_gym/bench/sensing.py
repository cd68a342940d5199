"""What a sensor would report of point features in the open: those in its view, and clutter."""

from __future__ import annotations

import math

import numpy as np

from slam_gym.geometry import observe
from slam_gym.types import Array, IntArray


def features_in_view(features: Array, pose: Array, reach: float, field_of_view: float = math.tau) -> IntArray:
    """Rows of `features` (n, 2) [m] within `reach` [m] of a pose (3,) and half a `field_of_view` [rad] of ahead."""
    near = np.flatnonzero(np.abs(features - pose[:2]).max(axis=1, initial=0.0) <= reach)
    local = observe(pose, np.ascontiguousarray(features[near]))
    ahead = np.abs(np.arctan2(local[:, 1], local[:, 0])) <= 0.5 * field_of_view
    return near[ahead & (np.hypot(local[:, 0], local[:, 1]) <= reach)]


def clutter(count: int, reach: float, field_of_view: float, rng: np.random.Generator) -> Array:
    """Points (count, 2) [m] in R, uniform over what the sensor has in view."""
    radius = reach * np.sqrt(rng.random(count))
    bearing = rng.uniform(-0.5 * field_of_view, 0.5 * field_of_view, count)
    return np.column_stack([radius * np.cos(bearing), radius * np.sin(bearing)])
