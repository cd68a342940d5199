"""Compiling on two cores: the first run ever has a process of its own compile part of the inner loops into the cache.

The main process compiles what it comes to. This one begins with what takes longest, the SLAM step, goes on with what an
episode needs last, and ends with what only some episodes need. Whoever comes to a kernel that the other is compiling
waits for it.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import subprocess
import sys
from dataclasses import replace

import numpy as np

from slam_gym import geometry
from slam_gym._compile import announce_compilation
from slam_gym.association import jcbb
from slam_gym.envs import observation
from slam_gym.mapping import linear_algebra
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics import association, map_quality, point_assignment
from slam_gym.navigation import grid, key_poses, visibility
from slam_gym.navigation.expected_gain import expected_reduction
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.planner import distance_field
from slam_gym.navigation.polyline import length_left, points_ahead
from slam_gym.navigation.pursuit import follow
from slam_gym.navigation.sweeps import MovableSweeps
from slam_gym.simulation import appraisal
from slam_gym.slam import kernels, lost, slam, whole_step
from slam_gym.slam.slam import Slam
from slam_gym.types import Array, Beams, Odometry, Prediction, Scan
from slam_gym.world import boxes, detection, driving, reachability, wall_grid

COMPILED = (
    geometry, slam, lost, observation, grid, key_poses, linear_algebra, point_assignment, association, boxes, detection,
    driving, reachability, visibility, wall_grid, appraisal, kernels, whole_step,
)  # fmt: skip
"""The modules of which Python calls inner loops in every episode, whoever drives and associates."""


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
    _step(points)
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
    _associate(points)


def _step(points: Array) -> None:
    """One step of SLAM."""
    Slam().step(Odometry(np.zeros(3), 1e-4 * np.eye(3)), Scan.from_points(points, sigma=0.1))


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
