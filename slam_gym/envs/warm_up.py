"""The modules whose inner loops every episode compiles on its first run ever, and the announcement of that."""

from __future__ import annotations

from slam_gym import geometry
from slam_gym._compile import announce_compilation
from slam_gym.envs import observation
from slam_gym.mapping import linear_algebra
from slam_gym.metrics import association, consistency, map_quality, point_assignment
from slam_gym.navigation import grid, keyframes, visibility
from slam_gym.slam import learn, slam, tracker
from slam_gym.world import detection, driving, ray_casting, reachability

COMPILED = (
    geometry, slam, tracker, observation, grid, keyframes, linear_algebra, point_assignment, association, detection,
    driving, ray_casting, reachability, visibility, consistency, map_quality, learn,
)  # fmt: skip


def warm_up() -> bool:
    """Say once, on stderr, that a compilation is due, if one is. Returns whether its result will be kept."""
    return announce_compilation(COMPILED)
