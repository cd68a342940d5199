"""Compiling on two cores: the first run ever has a process of its own compile half of the inner loops into the cache.

The main process compiles what an episode needs first (world, senses, filter), this one what it needs last.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import subprocess
import sys
from dataclasses import replace

import numpy as np

from slam_gym import geometry, validation
from slam_gym._compile import announce_compilation
from slam_gym.association import compatibility, jcbb, tree
from slam_gym.association.tracking import branch_and_bound
from slam_gym.envs import observation
from slam_gym.mapping import covisibility, ekf, foresight, linear_algebra, measurement, update
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics import association, consistency, map_quality, point_assignment
from slam_gym.navigation import grid, key_poses, polyline, redrawing, visibility
from slam_gym.navigation.expected_gain import expected_reduction
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.planner import distance_field
from slam_gym.navigation.polyline import length_left, points_ahead
from slam_gym.navigation.pursuit import follow
from slam_gym.navigation.sweeps import MovableSweeps
from slam_gym.simulation import appraisal
from slam_gym.slam import kernels, lost, slam, whole_step
from slam_gym.types import Array, Beams, Prediction, Scan
from slam_gym.world import boxes, detection, driving, ray_casting, reachability, wall_grid

COMPILED = (
    geometry, slam, lost, validation, compatibility, tree, observation, covisibility, ekf, grid, key_poses, polyline,
    redrawing, linear_algebra, measurement, point_assignment, association, consistency, map_quality, boxes, detection,
    ray_casting, reachability, update, visibility, wall_grid, foresight, appraisal, kernels, driving,
    whole_step, branch_and_bound,
)  # fmt: skip
"""The modules whose inner loops run in every episode, whoever drives and associates."""


def compile_on_two_cores() -> bool:
    """Announce a compilation that is due, and start the second process for it; nothing where the cache is filled.

    Returns whether one is due whose result will be kept.
    """
    due = announce_compilation(COMPILED)
    if due and multiprocessing.parent_process() is None:
        with contextlib.suppress(OSError):  # no second process to be had: this one compiles everything
            subprocess.Popen([sys.executable, "-m", __name__], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return due


def main() -> None:
    """Call every loop of the second half once, on the least data that reaches it."""
    points = np.array([[1.0, 0.0], [1.0, 1.0]])
    _associate(points)
    map_quality.map_error(points, points, 0.5)
    pose, explored = np.zeros(3), ExploredGrid(np.array([-4.0, -4.0, 4.0, 4.0]))
    _sweep(explored, points)
    explored.egocentric(pose, points)
    field = distance_field(explored, pose[:2], 0.25)
    explored.expected_area(explored.frontiers(field.reachable).centres, 6.0)
    path = field.path(field.nearest(points[0]))
    follow(pose, path)
    field.lengths_to(points_ahead(path, pose[:2], 0.2))
    length_left(path, pose[:2])
    mean, covariance = np.concatenate([pose, points.ravel()]), 0.01 * np.eye(7)
    expected_reduction(mean, covariance, explored, points, reach=6.0, sigma=0.1, drift=np.full((2, 3), 0.01))


def _sweep(explored: ExploredGrid, points: Array) -> None:
    """Two sweeps, the first moved by the second."""
    sweeps, beams = MovableSweeps(explored), Beams(np.linspace(-3.0, 3.0, 60), np.full(60, 2.0), 6.0)
    for pose in (np.zeros(3), np.ones(3)):
        seen = StochasticMap(pose=pose)
        seen.add(Scan.from_points(points, sigma=0.1), np.arange(2))
        sweeps.enter(pose, np.zeros(3), beams, seen.ids, seen)


def _associate(points: Array) -> None:
    """One search near, one far."""
    prediction = Prediction.from_gaussian(points, 0.01 * np.eye(4))
    local = np.array([True, False])
    jcbb(
        Scan.from_points(points, sigma=0.1),
        replace(prediction, near=local, local=lambda rows: np.ones((len(rows), len(rows)), np.bool_)),
    )


if __name__ == "__main__":
    main()
