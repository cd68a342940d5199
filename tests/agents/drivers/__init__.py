"""Goals laid out by hand, for the tests of the classical drivers."""

import numpy as np

from slam_gym.envs.observation import encode_goals
from slam_gym.simulation.goals import FRONTIERS, SLOTS, Goals


def offered(frontiers=(), revisits=(), pose=(0.0, 0.0, 0.0)):
    """Observation and info with goals given as (x, y, path, area, reduction), x and y in B."""
    positions, numbers, legal = np.zeros((SLOTS, 2)), np.zeros((SLOTS, 3)), np.zeros(SLOTS, bool)
    positions[0], legal[0] = pose[:2], True
    for first, goals in ((1, frontiers), (1 + FRONTIERS, revisits)):
        for slot, goal in enumerate(goals, first):
            positions[slot], numbers[slot], legal[slot] = goal[:2], goal[2:], True
    goals = Goals(positions, numbers[:, 0], numbers[:, 1], numbers[:, 2], legal)
    pose = np.array(pose)
    return {"goals": encode_goals(goals, pose)}, {"pose": pose, "action_mask": legal, "ticks": 5}
