"""Keyframes follow the map: a robot drives round a block, drifts, closes the loop, and no wall stands twice."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from slam_gym.geometry import compose, observe, relative, transform
from slam_gym.navigation.explored_grid import UNKNOWN, WALL, ExploredGrid
from slam_gym.navigation.keyframes import NO_PAIRS, Keyframes
from slam_gym.types import NO_ID, Array, Beams, IntArray
from slam_gym.world.ray_casting import NOTHING, cast, outlines, wall_index

OUTER, INNER = 13.9, 9.9  # [m] sides of the square corridor round a block
BEARINGS = np.linspace(-np.pi, np.pi, 60, endpoint=False)
REACH = 6.0
BOUNDS = np.array([-11.0, -11.0, 11.0, 11.0])
ROUND = 4 * (OUTER + INNER) / 2  # [m] the way once round, in the middle of the corridor


WALLS = outlines(np.array([[0.0, 0.0, side, side, 0.0] for side in (OUTER, INNER)]))
FEATURES = np.concatenate([WALLS[:, :2] + t * (WALLS[:, 2:] - WALLS[:, :2]) for t in (0.1, 0.35, 0.6, 0.9)])
INDEX = wall_index(WALLS)


def beams_from(pose):
    """Exact ranges to the walls."""
    return Beams(BEARINGS, cast(INDEX, pose[:2], pose[2] + BEARINGS, REACH, NOTHING), REACH)


def pose_at(way):
    """The true pose after so many metres round the block."""
    side, along = divmod(way % ROUND, ROUND / 4)
    half = ROUND / 8
    return compose(np.array([0.0, 0.0, side * math.pi / 2]), np.array([along - half, -half, 0.0]))


class Map(NamedTuple):
    """What sweeps follow."""

    ids: IntArray
    positions: Array


class Drive:
    """Dead reckoning that turns a little too far, features mapped where it has them, and the keyframes it opens."""

    def __init__(self, bend=0.006):
        self.grid = ExploredGrid(BOUNDS)
        self.keyframes, self.bend = Keyframes(self.grid), bend
        self.way, self.estimate, self.known = 0.0, pose_at(0.0), {}
        self.met = {}  # [m] of the way at which each feature was first seen

    def features(self):
        ids = np.array(sorted(self.known), np.int64)
        return Map(ids, np.array([self.known[i] for i in ids]).reshape(-1, 2))

    def tick(self, step=0.1):
        before = pose_at(self.way)
        self.way += step
        motion = relative(before, pose_at(self.way)) + np.array([0.0, 0.0, self.bend * step])
        self.estimate = compose(self.estimate, motion)
        self.look(motion)

    def look(self, motion, fused=NO_PAIRS):
        local = observe(pose_at(self.way), FEATURES)
        seen = np.flatnonzero(np.hypot(*local.T) < 3.0)
        for i in seen:
            self.met.setdefault(i, self.way)
        ids = np.array([i if self.way - self.met[i] < ROUND / 2 else 1000 + i for i in seen])  # not known again
        for i, at in zip(ids, transform(self.estimate, local[seen])):
            self.known.setdefault(i, at)
        self.keyframes.enter(self.estimate, motion, beams_from(pose_at(self.way)), ids, self.features(), fused)

    def close_the_loop(self):
        """Features come to lie where they are, and the pose; of those that are the same the younger disappear."""
        fused = np.array([[i % 1000, i] for i in self.known if i >= 1000])
        self.known = {i % 1000: FEATURES[i % 1000] for i in self.known}
        self.met = dict.fromkeys(self.met, self.way)
        self.estimate = pose_at(self.way)
        self.look(np.zeros(3), fused)


def astray(grid):
    """[m] from each wall cell to the nearest true wall."""
    rows, columns = np.nonzero(grid.cells == WALL)
    points = grid.origin + (np.column_stack([columns, rows]) + 0.5) * grid.resolution
    side = np.abs(points).max(axis=1)
    return np.minimum(np.abs(side - OUTER / 2), np.abs(side - INNER / 2))


def truly_drawn(drive):
    """The same sweeps, each entered where it was truly taken."""
    grid = ExploredGrid(BOUNDS)
    for way in np.arange(1, round(drive.way / 0.1) + 1) * 0.1:
        grid.integrate(pose_at(way), beams_from(pose_at(way)))
    return grid


def test_no_wall_stands_twice_after_a_loop_is_closed() -> None:
    drive = Drive()
    while drive.way < ROUND + 4.0:
        drive.tick()
    assert math.dist(drive.estimate[:2], pose_at(drive.way)[:2]) > 0.6
    assert (astray(drive.grid) > 0.4).sum() > 50  # drawn twice, or askew
    drive.close_the_loop()
    assert astray(drive.grid).max() < 0.3
    truth = truly_drawn(drive)
    both = (drive.grid.cells != UNKNOWN) & (truth.cells != UNKNOWN)
    assert both.sum() > 0.97 * (truth.cells != UNKNOWN).sum()
    assert (drive.grid.cells == truth.cells)[both].mean() > 0.97


def test_corrections_come_in_bit_by_bit_while_the_robot_goes_on() -> None:
    drive = Drive()
    while drive.way < ROUND:
        drive.tick()
    bent, strayed = dict(drive.known), drive.estimate - pose_at(drive.way)
    strayed[2] = math.remainder(strayed[2], 2 * math.pi)
    beams, nothing = beams_from(pose_at(drive.way)), np.array([NO_ID])
    for share in np.linspace(1.0, 0.0, 60):  # too slow to surprise, so that only the regular looks find it
        drive.known = {i: share * at + (1 - share) * FEATURES[i % 1000] for i, at in bent.items()}
        drive.keyframes.enter(pose_at(drive.way) + share * strayed, np.zeros(3), beams, nothing, drive.features())
    assert astray(drive.grid).max() < 0.4


def test_while_nothing_moves_the_grid_is_that_of_sweeps_entered_for_good() -> None:
    drive, plain = Drive(bend=0.0), ExploredGrid(BOUNDS)
    for _ in range(200):
        drive.tick()
        plain.integrate(drive.estimate, beams_from(pose_at(drive.way)))
    np.testing.assert_array_equal(drive.grid.cells, plain.cells)


def test_space_seen_with_another_map_is_taken_out_and_comes_back_with_it() -> None:
    drive = Drive(bend=0.0)
    for _ in range(60):
        drive.tick()
    first, seen = dict(drive.known), drive.grid.cells.copy()
    assert (seen == WALL).sum() > 30
    drive.known = {}
    elsewhere, far = np.array([-9.0, 9.0, 0.0]), np.array([999])
    alone = Beams(BEARINGS, np.full(len(BEARINGS), 1.0), REACH)
    for _ in range(5):
        drive.keyframes.enter(elsewhere, np.zeros(3), alone, far, Map(far, np.array([[-9.0, 8.0]])))
    assert 0 < (drive.grid.cells != UNKNOWN).sum() < 120  # a disc of 1 m
    joined = Map(np.array([*first, 999]), np.array([*first.values(), [-9.0, 8.0]]))
    for _ in range(25):
        drive.keyframes.enter(elsewhere, np.zeros(3), alone, far, joined)
    known = seen != UNKNOWN
    assert (drive.grid.cells == seen)[known].mean() > 0.98


def test_what_cannot_be_entered_is_refused() -> None:
    drive = Drive()
    drive.tick()
    with pytest.raises(ValueError, match="pose"):
        drive.keyframes.enter(np.array([0.0, math.nan, 0.0]), np.zeros(3), beams_from(np.zeros(3)), np.array([0]),
                           drive.features())  # fmt: skip
    with pytest.raises(ValueError, match="beams: 2 of them, where sweeps so far had 60"):
        drive.keyframes.enter(np.zeros(3), np.zeros(3), Beams(np.zeros(2), np.ones(2), REACH), np.array([0]),
                           drive.features())  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_explored_space_moves_with_the_features_seen_there(seed) -> None:
    rng = np.random.default_rng(seed)
    shift = np.array([*rng.uniform(-1.5, 1.5, 2), rng.uniform(-0.3, 0.3)])
    drive, expected = Drive(bend=0.0), ExploredGrid(BOUNDS)
    for _ in range(80):
        drive.tick()
        expected.integrate(compose(shift, drive.estimate), beams_from(pose_at(drive.way)))
    drive.known = {i: transform(shift, at[None])[0] for i, at in drive.known.items()}
    drive.estimate = compose(shift, drive.estimate)
    for _ in range(25):
        drive.look(np.zeros(3))
    both = (drive.grid.cells != UNKNOWN) & (expected.cells != UNKNOWN)
    assert both.sum() > 0.9 * (expected.cells != UNKNOWN).sum()
    assert (drive.grid.cells == expected.cells)[both].mean() > 0.9


def test_space_seen_where_no_feature_was_stays() -> None:
    grid, nobody = ExploredGrid(BOUNDS), Map(np.empty(0, np.int64), np.empty((0, 2)))
    keyframes, pose = Keyframes(grid), pose_at(0.0)
    keyframes.enter(pose, np.zeros(3), beams_from(pose), np.array([NO_ID]), nobody)
    drawn, far = grid.cells.copy(), Map(np.array([5]), np.array([[9.0, 9.0]]))
    for x in range(30):
        keyframes.enter(
            pose, np.zeros(3), beams_from(pose), np.array([NO_ID]), far._replace(positions=far.positions + x)
        )
    assert (grid.cells == drawn)[drawn != UNKNOWN].all()
