"""The relocation problems of a level: a map, and a scan from somewhere in it, or from another building."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from agents.suite.problems import LEAST, Course
from slam_gym.geometry import wrap_angle
from slam_gym.mapping.locality import covisible
from slam_gym.scenarios.suite import Level
from slam_gym.types import Array, Landmarks, Locality, Relocation, Scan

NEAR = 0.3  # [m] an answer is right within this distance …
TURNED = math.radians(3.0)  # [rad] … and this angle
ELSEWHERE = 5_000  # the other building is the world of this many numbers further on


@dataclass(frozen=True)
class Kidnapping:
    """A scan, the map that it may be of, and where it was taken."""

    scan: Scan
    landmarks: Landmarks
    locality: Locality
    pose: Array | None  # (3,) of the robot in B, as true associations put it; None: in another building


def kidnappings(level: Level, world: int, count: int, split: str = "test") -> Iterator[Kidnapping]:
    """Up to `count`: half inside the map, over the second lap; then as many from another building."""
    course, inside = Course(level, world, split), 0
    for look in course.sampled((count + 1) // 2):
        inside += 1
        landmarks, locality = look.slam.map.landmarks(), covisible(look.slam.covisibility)
        known = look.slam.map.copy()
        known.predict(look.odometry)
        known.update(look.scan, look.right)
        yield Kidnapping(look.scan, landmarks, locality, known.pose)
    other = Course(level, (world + ELSEWHERE) % 10_000, split)
    for pose in other.rng.permutation(other.poses):
        scan, truth = other.look(pose)
        if inside and (truth.sources >= 0).sum() >= LEAST:
            inside -= 1
            yield Kidnapping(scan, landmarks, locality, None)


def outcome(found: Relocation, truth: Array | None) -> str:
    """`correct`, `wrong` or `silent` inside the map; `refused` or `invented` outside of it."""
    if truth is None:
        return "invented" if found.accepted else "refused"
    if not found.accepted:
        return "silent"
    off = math.hypot(found.pose[0] - truth[0], found.pose[1] - truth[1])
    return "correct" if off <= NEAR and abs(wrap_angle(found.pose[2] - truth[2])) <= TURNED else "wrong"
