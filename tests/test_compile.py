"""That a compilation is announced when an episode is about to compile, and only then."""

import os
import subprocess
import sys

PRELUDE = """
import sys
import numba
import slam_gym.envs.base
import slam_gym.envs.explore
from slam_gym._compile import announce_compilation
from slam_gym.envs.warm_up import COMPILED
"""
EPISODE = """
slam_gym.envs.base.compile_on_two_cores = lambda: None
env = slam_gym.envs.explore.ExploreEnv(action="twist", associator="nearest_neighbour")
env.reset(seed=0)
env.step((0.5, 0.1))
kernels = [
    value for name, module in list(sys.modules.items()) if name.startswith("slam_gym")
    for value in vars(module).values() if isinstance(value, numba.core.dispatcher.Dispatcher)
]
used = {kernel.py_func.__module__ for kernel in kernels if kernel.signatures}
print(sorted(used - {module.__name__ for module in COMPILED}))
"""


def run(code: str, **environment: str) -> tuple[str, str]:
    """What a fresh process prints and says on stderr."""
    command = [sys.executable, "-c", PRELUDE + code]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | environment, check=True)
    return done.stdout, done.stderr


def test_an_empty_cache_is_announced_once(tmp_path) -> None:
    twice = "print(announce_compilation(COMPILED), announce_compilation(COMPILED))"
    said, announced = run(twice, NUMBA_CACHE_DIR=str(tmp_path))
    assert said == "True False\n"
    assert announced.count("compiling") == 1 and "once, then cached" in announced


def test_silent_after_an_episode_of_the_least_that_explore_does() -> None:
    unlisted, _ = run(EPISODE)
    assert unlisted == "[]\n", "kernels of every episode whose modules COMPILED does not name"
    assert run("print(announce_compilation(COMPILED))") == ("False\n", "")
