"""Observations of `Explore-v0`: finite, scaled, flat vectors and one egocentric image, relative to the estimate."""

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from slam_gym._jit import compiled
from slam_gym.association.prediction import Prediction
from slam_gym.association.walks import POSITION_SCALE, SIGMA_SCALE, SIZE_SCALE, Float32Array, squash
from slam_gym.envs.base import box
from slam_gym.geometry import observe as seen_from
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.explored_grid import Blocks, Cells, ExploredGrid, draw_egocentric
from slam_gym.simulation.goals import FRONTIERS, SLOTS, Goals
from slam_gym.types import Array, Scan

POINT_FIELDS = ("present", "x", "y", "sigma_x", "correlation", "sigma_y", "size")
"""Columns of a measurement, and of a map feature in the last prediction."""

GOAL_FIELDS = ("legal", "x", "y", "path", "area", "reduction", "frontier", "revisit", "in_view")
"""Columns of `observation["goals"]` reshaped to (SLOTS, 9); `unsquash_goals` converts them to their units."""

FEATURES = 32  # nearest map features in an observation
PIXELS = 48  # side of the image
METRES = 24.0  # [m] side of the square that the image shows

HEADING_SCALE = 0.05  # [rad]
GOAL_SCALE = 10.0  # [m] of x, y in the robot frame, and of the path length
AREA_SCALE = 10.0  # [m²]
REDUCTION_SCALE = 0.1  # [m²]
VIEW_SCALE = 5.0  # features in view along the path


def unsquash(value: Any, scale: float) -> Any:
    """The inverse of `squash`; values are clipped to ±(1 − 1e-6) before."""
    value = np.clip(value, -1.0 + 1e-6, 1.0 - 1e-6)
    return scale * value / (1.0 - np.abs(value))


def observation_space(measurements: int, goals: bool) -> spaces.Dict:
    """The observation space for scans of at most `measurements`, in twist mode without `goals`."""
    parts: dict[str, spaces.Space[Any]] = {
        "scan": box(measurements * len(POINT_FIELDS)),
        "features": box(FEATURES * len(POINT_FIELDS)),
        "uncertainty": box(3, 0.0),
        "budget": box(1, 0.0),
        "image": spaces.Box(0, 255, (3, PIXELS, PIXELS), np.uint8),
    }
    if goals:
        parts["goals"] = box(SLOTS * len(GOAL_FIELDS))
    return spaces.Dict(parts)


_Points = tuple[Array, Array, Array]  # points (k, 2), their covariances (k, 2, 2) and sizes (k,)


def observe(
    scan: Scan, prediction: Prediction, slam_map: StochasticMap, grid: ExploredGrid, measurements: int, left: float
) -> dict[str, Any]:
    """The observation without goals, for scans of at most `measurements`; `left` is the fraction of the budget left.

    It contains measurements, and map features where they were expected before the scan, in the robot frame; standard
    deviations of the pose; and an image of free space, walls and feature density around the robot, heading up.
    """
    (x, P, _, _), known = slam_map.arrays, prediction.expected
    seen, places = (scan.points, scan.covariances, scan.sizes), (known.positions, known.covariances, known.sizes)
    measured, expected, uncertainty, image = _observe(seen, places, x, P, slam_map.n, grid.drawn, measurements)
    budget = np.array([left], np.float32)
    return {"scan": measured, "features": expected, "uncertainty": uncertainty, "image": image, "budget": budget}


def encode_goals(goals: Goals, pose: Array) -> Float32Array:
    """Goals as a flat observation (SLOTS · 9,), with positions in the frame of `pose` (3,)."""
    local = seen_from(pose, goals.positions)
    out = np.zeros((SLOTS, len(GOAL_FIELDS)), np.float32)
    out[:, 0] = 1.0
    out[:, 1:3] = squash(local, GOAL_SCALE)
    out[:, 3] = squash(goals.lengths, GOAL_SCALE)
    out[:, 4] = squash(goals.areas, AREA_SCALE)
    out[:, 5] = squash(goals.reductions, REDUCTION_SCALE)
    out[:, 8] = squash(goals.in_view, VIEW_SCALE)
    out[1 : 1 + FRONTIERS, 6] = 1.0
    out[1 + FRONTIERS :, 7] = 1.0
    out[~goals.legal] = 0.0
    return out.ravel()


def unsquash_goals(observed: NDArray[np.float32]) -> dict[str, Array]:
    """The goals of an observation by `GOAL_FIELDS`, each (SLOTS,): in [m], [m²], numbers of features, or 0 and 1.

    Raises ValueError where the length is not a multiple of the number of fields.
    """
    if np.size(observed) % len(GOAL_FIELDS):
        raise ValueError(f"goals: {np.size(observed)} numbers do not divide into rows of {len(GOAL_FIELDS)}")
    columns = dict(zip(GOAL_FIELDS, np.asarray(observed, np.float64).reshape(-1, len(GOAL_FIELDS)).T))
    scales = {"x": GOAL_SCALE, "y": GOAL_SCALE, "path": GOAL_SCALE}
    scales |= {"area": AREA_SCALE, "reduction": REDUCTION_SCALE, "in_view": VIEW_SCALE}
    return {name: unsquash(column, scales[name]) if name in scales else column for name, column in columns.items()}


@compiled
def _observe(
    scan: _Points,
    prediction: _Points,
    x: Array,
    P: Array,
    n: int,
    drawn: tuple[Blocks, Array, float],
    measurements: int,
) -> tuple[Float32Array, Float32Array, Float32Array, Cells]:
    """Scan and prediction as `POINT_FIELDS`, the uncertainty of the pose, and the image."""
    measured, expected = np.zeros(7 * measurements, np.float32), np.zeros(7 * FEATURES, np.float32)
    uncertainty, image = np.empty(3, np.float32), np.empty((3, PIXELS, PIXELS), np.uint8)
    _encode(*scan, measured)
    _encode(*prediction, expected)
    for i in range(3):
        sigma = math.sqrt(max(P[i, i], 0.0))
        uncertainty[i] = sigma / (sigma + (HEADING_SCALE if i == 2 else SIGMA_SCALE))
    draw_egocentric(*drawn, x[:3], x[3 : 3 + 2 * n].reshape(n, 2), METRES, image)
    return measured, expected, uncertainty, image


@compiled
def _encode(points: Array, covariances: Array, sizes: Array, out: Float32Array) -> None:
    """Write to `out` as many rows of `POINT_FIELDS` as fit, nearest first; an unknown size, NaN, stays 0."""
    order = np.argsort(points[:, 0] ** 2 + points[:, 1] ** 2, kind="mergesort")
    for row in range(min(len(out) // 7, points.shape[0])):
        i, at = order[row], 7 * row
        sx, sy = math.sqrt(max(covariances[i, 0, 0], 0.0)), math.sqrt(max(covariances[i, 1, 1], 0.0))
        out[at] = 1.0
        out[at + 1] = points[i, 0] / (abs(points[i, 0]) + POSITION_SCALE)
        out[at + 2] = points[i, 1] / (abs(points[i, 1]) + POSITION_SCALE)
        out[at + 3] = sx / (sx + SIGMA_SCALE)
        out[at + 4] = 0.0 if sx * sy == 0.0 else max(-1.0, min(1.0, covariances[i, 0, 1] / (sx * sy)))
        out[at + 5] = sy / (sy + SIGMA_SCALE)
        if not math.isnan(sizes[i]):
            out[at + 6] = sizes[i] / (abs(sizes[i]) + SIZE_SCALE)
