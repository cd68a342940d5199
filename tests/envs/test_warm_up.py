"""What is compiled ahead is what episodes use, and the announcement knows the modules of every episode."""

import functools
import os
import subprocess
import sys

from slam_gym.association import jcbb, marginal
from slam_gym.envs.warm_up import prepared_for

PRELUDE = """
import sys
import numba
import slam_gym.envs.base
import slam_gym.envs.explore
from slam_gym._compile import announce_compilation
from slam_gym.envs import warm_up

slam_gym.envs.base.compile_on_two_cores = lambda *_: None

def compiled():
    kernels = {
        value for name, module in list(sys.modules.items()) if name.startswith("slam_gym")
        for value in vars(module).values() if isinstance(value, numba.core.dispatcher.Dispatcher)
    }
    return {(kernel.py_func.__module__, kernel.__name__): set(map(str, kernel.signatures)) for kernel in kernels}

def episode(*actions, **options):
    env = slam_gym.envs.explore.ExploreEnv("office-small", **options)
    env.reset(seed=0)
    for action in actions:
        env.step(action)
"""
LEAST = """
episode((0.5, 0.1), action="twist", associator="nearest_neighbour")
used = {module for (module, _), signatures in compiled().items() if signatures}
used.discard("slam_gym.association.tracking.nearest_neighbour")  # which decides in this episode only
print(sorted(used - {module.__name__ for module in warm_up.COMPILED}))
"""
AHEAD = """
warm_up.main()
ahead = {kernel: signatures for kernel, signatures in compiled().items() if signatures}
episode(0, 1)
after = compiled()
print(len(ahead) > 10, [kernel for kernel in ahead if after[kernel] != ahead[kernel]])
"""


def run(code: str) -> tuple[str, str]:
    """What a fresh process prints and says on stderr."""
    command = [sys.executable, "-c", PRELUDE + code]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ, check=True)
    return done.stdout, done.stderr


def test_silent_after_an_episode_of_the_least_that_explore_does() -> None:
    unlisted, _ = run(LEAST)
    assert unlisted == "[]\n", "kernels of every episode whose modules COMPILED does not name"
    assert run("print(announce_compilation(warm_up.COMPILED))") == ("False\n", "")


def test_what_is_compiled_ahead_is_what_an_episode_calls_with_the_same_types() -> None:
    said, _ = run(AHEAD)
    assert said == "True []\n", "an episode compiles these again for other types"


def test_the_step_that_is_prepared_is_that_of_the_associator_if_it_is_one_call() -> None:
    mine = functools.partial(jcbb, node_limit=100)
    asked = ("marginal", marginal, "singles", "ipjc", "true_association", mine)
    assert [*map(prepared_for, asked)] == ["marginal", "marginal", "singles", "jcbb", "jcbb", "jcbb"]
