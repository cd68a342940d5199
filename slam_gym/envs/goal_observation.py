"""The goals of `Explore-v0` as an agent sees them, and back in their units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_gym.envs.observation import Float32Array, squash, unsquash
from slam_gym.geometry import observe
from slam_gym.simulation.goals import FRONTIERS, SLOTS, Goals
from slam_gym.types import Array

GOAL_FIELDS = ("legal", "x", "y", "path", "area", "reduction", "frontier", "revisit", "in_view")
"""Columns of `observation["goals"]` reshaped to (SLOTS, 9); `unsquash_goals` gives them back in their units."""

POSITION_SCALE = 10.0  # [m] of x, y in the robot frame, and of the path length
AREA_SCALE = 10.0  # [m²]
REDUCTION_SCALE = 0.1  # [m²]
VIEW_SCALE = 5.0  # features in view on the way


def encode_goals(goals: Goals, pose: Array) -> Float32Array:
    """Goals as the flat observation (SLOTS · 9,): positions turned into the frame of `pose` (3,)."""
    local = observe(pose, goals.positions)
    out = np.zeros((SLOTS, len(GOAL_FIELDS)), np.float32)
    out[:, 0] = 1.0
    out[:, 1:3] = squash(local, POSITION_SCALE)
    out[:, 3] = squash(goals.lengths, POSITION_SCALE)
    out[:, 4] = squash(goals.areas, AREA_SCALE)
    out[:, 5] = squash(goals.reductions, REDUCTION_SCALE)
    out[:, 8] = squash(goals.in_view, VIEW_SCALE)
    out[1 : 1 + FRONTIERS, 6] = 1.0
    out[1 + FRONTIERS :, 7] = 1.0
    out[~goals.legal] = 0.0
    return out.ravel()


def unsquash_goals(observed: NDArray[np.float32]) -> dict[str, Array]:
    """The goals of an observation in their units, by `GOAL_FIELDS`: [m], [m²], 0 or 1, and features, each (SLOTS,).

    Raises ValueError where the length does not fit.
    """
    if np.size(observed) % len(GOAL_FIELDS):
        raise ValueError(f"goals: {np.size(observed)} numbers do not divide into rows of {len(GOAL_FIELDS)}")
    columns = dict(zip(GOAL_FIELDS, np.asarray(observed, np.float64).reshape(-1, len(GOAL_FIELDS)).T))
    scales = {"x": POSITION_SCALE, "y": POSITION_SCALE, "path": POSITION_SCALE}
    scales |= {"area": AREA_SCALE, "reduction": REDUCTION_SCALE, "in_view": VIEW_SCALE}
    return {name: unsquash(column, scales[name]) if name in scales else column for name, column in columns.items()}
