"""Compiling on two cores: the first run ever has a process of its own compile part of the inner loops into the cache.

The main process compiles what it comes to. The other one begins with what takes longest, the SLAM step, and goes on
with what an episode needs after it. Whoever comes to a kernel that the other is compiling does not wait for it idly:
the main process takes from the end of the same list meanwhile.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import subprocess
import sys
from typing import NamedTuple

import numpy as np

from slam_gym import geometry
from slam_gym._claims import meanwhile
from slam_gym._compile import announce_compilation
from slam_gym.association import ASSOCIATORS
from slam_gym.envs import observation
from slam_gym.mapping import linear_algebra
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics import association, point_assignment
from slam_gym.navigation import grid, keyframes, visibility
from slam_gym.navigation.expected_gain import expected_reduction
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.keyframes import Keyframes
from slam_gym.navigation.planner import distance_field
from slam_gym.navigation.pursuit import follow, length_left, points_ahead
from slam_gym.navigation.visibility import FieldOfView, ViewsFrom
from slam_gym.simulation import appraisal
from slam_gym.slam import kernels, slam, tracker, whole_step
from slam_gym.slam.at_once import form_of
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Array, Associator, Beams, IntArray, Odometry, Prediction, Scan
from slam_gym.world import boxes, detection, driving, reachability, wall_grid
from slam_gym.world.floor_plan import Features, FloorPlan
from slam_gym.world.physics import DynamicsSpec, RobotSpec, World

COMPILED = (
    geometry, slam, tracker, observation, grid, keyframes, linear_algebra, point_assignment, association, boxes,
    detection, driving, reachability, visibility, wall_grid, appraisal, kernels, whole_step,
)  # fmt: skip
"""The modules of which Python calls inner loops in every episode, whoever drives and associates."""

_POINTS = np.array([[1.0, 0.0], [1.0, 1.0]])
_BOUNDS = np.array([-4.0, -4.0, 4.0, 4.0])


def compile_on_two_cores(associator: str | Associator = "jcbb") -> bool:
    """Announce a compilation that is due, and start the second process for it; nothing where the cache is filled.

    `associator` is the one of the steps to come. Returns whether a compilation is due whose result will be kept.
    """
    due = announce_compilation(COMPILED)
    if due and multiprocessing.parent_process() is None:
        with contextlib.suppress(OSError):  # no second process to be had: this one compiles everything
            command = [sys.executable, "-m", __name__, prepared_for(associator)]
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            meanwhile.extend(AFTERWARDS)
    return due


def prepared_for(associator: str | Associator) -> str:
    """The name of an associator whose step of SLAM is one compiled call: that of this one, if it has one."""
    asked = ASSOCIATORS.get(associator) if isinstance(associator, str) else associator
    return next((name for name, known in ASSOCIATORS.items() if known is asked and form_of(known) is not None), "jcbb")


def main(associator: str = "jcbb") -> None:
    """Call the inner loops once, on the least data that reaches them."""
    _step(associator)
    for part in AFTERWARDS:
        part()


def _step(associator: str) -> None:
    """One step of SLAM."""
    view_from = ViewsFrom(FieldOfView(6.0, 6.0), _explored().explored)
    Slam(SlamSpec(reach=6.0), view_from).step(_odometry(), _scan(), associator, plain=True)


def _odometry() -> Odometry:
    return Odometry(np.zeros(3), 1e-4 * np.eye(3))


def _scan() -> Scan:
    return Scan.from_points(_POINTS, sigma=0.1)


def _explored() -> ExploredGrid:
    return ExploredGrid(_BOUNDS)


def _sweeps() -> None:
    """Two sweeps, the first moved by the second, and what is seen of them."""
    explored = _explored()
    sweeps, beams = Keyframes(explored), Beams(np.linspace(-3.0, 3.0, 60), np.full(60, 2.0), 6.0)
    for x, pose in enumerate((np.zeros(3), np.ones(3))):
        sweeps.enter(pose, np.zeros(3), beams, np.arange(2), _Places(np.arange(2), _POINTS + x))


class _Places(NamedTuple):
    """Features as sweeps take them."""

    ids: IntArray
    positions: Array


def _goals() -> None:
    """What proposes goals and leads to them."""
    explored, pose = _explored(), np.zeros(3)
    field = distance_field(explored, pose[:2], 0.25)
    explored.expected_area(explored.frontiers(field.reachable).centres, 6.0)
    path = field.path(field.nearest(_POINTS[0]))
    follow(pose, path)
    field.lengths_to(points_ahead(path, pose[:2], 0.2))
    length_left(path, pose[:2])


def _gain() -> None:
    mean, covariance = np.concatenate([np.zeros(3), _POINTS.ravel()]), 0.01 * np.eye(7)
    expected_reduction(mean, covariance, _explored(), _POINTS, reach=6.0, sigma=0.1, drift=np.full((2, 3), 0.01))


def _motion() -> None:
    """The robot between four walls."""
    corners = _BOUNDS[[0, 1, 2, 1, 2, 3, 0, 3]].reshape(4, 2)
    walls = np.hstack([corners, np.roll(corners, -1, axis=0)])
    plan = FloorPlan("four walls", walls, Features(_POINTS, np.zeros(2, np.int64), np.ones(2)))
    World(plan, np.zeros(3), RobotSpec(), DynamicsSpec(), np.random.default_rng(0)).tick(1.0, 0.0)


def _appraisal() -> None:
    """The estimate held against the truth."""
    m, base = StochasticMap(), np.zeros(3)
    x, P, _, _ = m.arrays
    appraisal.appraise_pose(x, P, base, base, np.empty(3))
    targets, cells = point_assignment.indexed(_POINTS, 1.0), _explored().cells
    appraisal.appraise_map(m.arrays, m.n, 2, base, targets, cells, np.zeros(1, np.int64))


def _picture() -> None:
    """What an agent sees."""
    expected = Prediction.from_gaussian(_POINTS, 0.01 * np.eye(4))
    observation.observe(_scan(), expected, StochasticMap(), _explored(), 20, 1.0)


AFTERWARDS = (_motion, _appraisal, _picture, _gain, _goals, _sweeps)
"""What episodes need after their first step of SLAM."""


if __name__ == "__main__":
    main(*sys.argv[1:])
