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


def test_so_it_is_for_those_who_call_slam_themselves(tmp_path) -> None:
    _, announced = run("from slam_gym import Slam\nSlam(), Slam()", NUMBA_CACHE_DIR=str(tmp_path))
    assert announced.count("compiling") == 1


def test_what_another_interpreter_has_compiled_is_no_use_to_this_one(tmp_path) -> None:
    fill = (
        "from slam_gym import _compile\n"
        "for module in COMPILED:\n"
        "    (_compile._folder(_compile.Path(module.__file__)) / 'kernel.nbi').touch()\n"
    )
    ask, other = "print(announce_compilation(COMPILED))", "import sys; sys.implementation.cache_tag = 'other-1'\n"
    run(fill, NUMBA_CACHE_DIR=str(tmp_path))
    assert run(ask, NUMBA_CACHE_DIR=str(tmp_path))[0] == "False\n"
    command = [sys.executable, "-c", other + PRELUDE + ask]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    assert subprocess.run(command, capture_output=True, text=True, env=environment, check=True).stdout == "True\n"


def test_without_compilation_an_episode_is_the_same_but_for_rounding():
    """`NUMBA_DISABLE_JIT=1` is how to step through the inner loops in a debugger."""
    script = (
        "import gymnasium as gym, slam_gym\n"
        "for name, options in (('Explore', {'action': 'twist'}), ('Relocate', {'overrides': {'budget': 1}})):\n"
        "    env = gym.make(f'slam_gym/{name}-v0', scenario='office-small', disable_env_checker=True, **options)\n"
        "    observation, info = env.reset(seed=0)\n"
        "    observation, reward, *_ = env.step([1.0, 0.5] if name == 'Explore' else 0)\n"
        "    print(name, *(f'{float(part.sum()):.4f}' for part in observation.values()), f'{reward:.5f}')\n"
    )
    plain, quick = (
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", script], env=os.environ | {"NUMBA_DISABLE_JIT": switch},
            capture_output=True, text=True, check=True,
        ).stdout
        for switch in ("1", "0")
    )  # fmt: skip
    assert plain == quick and plain.count("\n") == 2
