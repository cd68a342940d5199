"""Entries of users, good and bad."""

import os
import time

import numpy as np

from slam_gym.association import jcbb, nearest_neighbour


class Snooping:
    """A driver that fails as soon as its process holds an environment, or its information the truth."""

    name, action = "snooping", "goal"

    def reset(self, seed):
        self.seed = seed

    def act(self, observation, info):
        import gc

        from slam_gym.envs.base import BaseEnv
        from slam_gym.simulation.episode import Episode

        if any(isinstance(found, BaseEnv | Episode) for found in gc.get_objects()):
            raise RuntimeError("an environment is in this process")
        if set(info) - {"pose", "ticks", "action_mask"}:
            raise RuntimeError(f"told {sorted(info)}")
        print("what an entry prints is not taken for an answer")
        return int(np.flatnonzero(info["action_mask"])[-1])


def failing(scan, prediction):
    """An associator that raises."""
    raise ValueError("no idea")


def dying(scan, prediction):
    """One that ends its process."""
    os._exit(3)


def slow(scan, prediction):
    """One that takes too long."""
    time.sleep(60)


def answering_nonsense(scan, prediction):
    """One whose answer is none."""
    return {"features": [1, 2, 3]}


def careful(scan, prediction):
    """JCBB, and what it may look at while it decides."""
    assert not hasattr(prediction.joint, "__self__")
    return jcbb(scan, prediction)


def mine(scan, prediction):
    return nearest_neighbour(scan, prediction)
