"""That a compilation is announced when there is one to come, once."""

import os
import subprocess
import sys

PRELUDE = """
from slam_gym._compile import announce_compilation
from slam_gym.envs.warm_up import COMPILED
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
