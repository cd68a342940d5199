"""The relocation problems of a level: a map, and a scan from somewhere in it, or from another building."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from agents.suite.problems import MIN_MAPPED, TwoLaps
from slam_gym.geometry import wrap_angle
from slam_gym.mapping.locality import covisible
from slam_gym.scenarios import SPLITS
from slam_gym.scenarios.suite import Level
from slam_gym.types import Array, Landmarks, Locality, Relocation, Scan

OUTCOMES = ("correct", "silent", "wrong", "refused", "invented")
MAX_DISTANCE = 0.3  # [m] an answer is right within this distance …
MAX_TURN = math.radians(3.0)  # [rad] … and this angle
OTHER_BUILDING = 5_000  # it is the world of this many numbers further on


@dataclass(frozen=True)
class RelocationProblem:
    """A scan, the map that it may be of, and where it was taken."""

    scan: Scan
    landmarks: Landmarks
    locality: Locality
    pose: Array | None  # (3,) of the robot in B, as true associations put it; None: in another building


def relocation_problems(level: Level, world: int, count: int, split: str = "test") -> Iterator[RelocationProblem]:
    """Up to `count`: half inside the map, over the second lap; then as many from another building."""
    inside = 0
    for stop in TwoLaps(level, world, split).sampled((count + 1) // 2):
        inside += 1
        landmarks, locality = stop.slam.map.landmarks(), covisible(stop.slam.covisibility)
        known = stop.slam.map.copy()
        known.predict(stop.odometry)
        known.update(stop.scan, stop.truth.right)
        yield RelocationProblem(stop.scan, landmarks, locality, known.pose)
    other = TwoLaps(level, (world + OTHER_BUILDING) % SPLITS["test"][1], split)
    for pose in other.rng.permutation(other.poses):
        scan, truth = other.look(pose)
        if inside and np.count_nonzero(truth.sources >= 0) >= MIN_MAPPED:
            inside -= 1
            yield RelocationProblem(scan, landmarks, locality, None)


def judge_relocation(found: Relocation, truth: Array | None) -> str:
    """`correct`, `wrong` or `silent` inside the map; `refused` or `invented` outside of it."""
    if truth is None:
        return "invented" if found.accepted else "refused"
    if not found.accepted:
        return "silent"
    off = math.hypot(found.pose[0] - truth[0], found.pose[1] - truth[1])
    return "correct" if off <= MAX_DISTANCE and abs(wrap_angle(found.pose[2] - truth[2])) <= MAX_TURN else "wrong"
