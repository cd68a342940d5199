"""Entries of users, good and bad."""

import os
import subprocess
import sys
import time

import numpy as np

from slam_gym.association import nearest_neighbour


class Driver:
    """Takes the last legal goal; the bad ones below do something else at their second decision."""

    name, action = "driver", "goal"

    def reset(self, seed):
        self.decisions = 0

    def act(self, observation, info):
        assert set(info) <= {"pose", "ticks", "action_mask"}
        print("what an entry prints is not taken for an answer")
        self.decisions += 1
        return int(np.flatnonzero(info["action_mask"])[-1]) if self.decisions == 1 else self.decide(info)

    def decide(self, info):
        return int(np.flatnonzero(info["action_mask"])[-1])


class Snooping(Driver):
    """Looks for a simulator in its process, and replaces whatever scores it."""

    def decide(self, info):
        import gc

        assert sys.stdin.read() == ""
        import agents.evaluation.episodes
        import slam_gym.metrics.map_quality
        from slam_gym.envs.base import BaseEnv
        from slam_gym.simulation.episode import Episode

        assert not any(isinstance(found, BaseEnv | Episode) for found in gc.get_objects())
        agents.evaluation.episodes.run_episode = lambda *_: {"map_error": 0.0}
        slam_gym.metrics.map_quality.map_quality = lambda *_, **__: None
        return super().decide(info)


class Raising(Driver):
    def decide(self, info):
        raise ValueError("no idea\ud800\x1b[31m")


class Exiting(Driver):
    def decide(self, info):
        os._exit(3)


class Leaving(Driver):
    """Ends, and leaves a process behind that keeps a pipe open."""

    def decide(self, info):
        pipe = os.open(os.environ["LEFT"], os.O_WRONLY)
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], stdout=pipe)
        os._exit(3)


class Sleeping(Driver):
    def decide(self, info):
        time.sleep(3600)


class Illegal(Driver):
    def decide(self, info):
        return int(np.flatnonzero(~info["action_mask"])[0])


class Writing(Driver):
    """Writes what is no answer to wherever it can."""

    def decide(self, info):
        for number in range(3, 64):
            try:
                os.write(number, b'[[["nonsense\n')
            except OSError:
                continue
        return super().decide(info)


class Flooding(Driver):
    """Answers without an end."""

    def decide(self, info):
        return [1] * 2_000_000


def pairing_all_with_one(scan, prediction):
    answer = nearest_neighbour(scan, prediction)
    answer.features[:] = 10**6
    return answer


def answering_a_list(scan, prediction):
    return [1, 2, 3]


def mine(scan, prediction):
    return nearest_neighbour(scan, prediction)
