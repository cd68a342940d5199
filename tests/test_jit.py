"""Compiled loops: announced where they are due, kept, and made again where what was kept is damaged."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

STEP = """
import numpy as np
from slam_gym.mapping import linear_algebra
print(linear_algebra.cholesky(4.0 * np.eye(3)))
"""


SAY = "from slam_gym._jit import announce_compilation as say\n"


def run(code: str, cache: Path) -> tuple[str, str]:
    """What a fresh process prints and says on stderr."""
    command, environment = [sys.executable, "-c", code], os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    return done.stdout, done.stderr


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache in which there is what STEP calls."""
    folder = tmp_path_factory.mktemp("compiled")
    assert run(STEP, folder)[0] == "True\n" and list(folder.rglob("*.nbi"))
    return folder


@pytest.fixture
def cache(compiled: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(compiled, tmp_path / "cache"))


def test_an_empty_cache_is_announced_once(tmp_path: Path) -> None:
    said, announced = run(SAY + "print(say(), say())", tmp_path)
    assert said == "True False\n"
    assert announced.count("compiling") == 1 and "once, then cached" in announced


def test_so_it_is_for_those_who_call_slam_themselves(tmp_path: Path) -> None:
    _, announced = run("from slam_gym import Slam\nSlam(), Slam()", tmp_path)
    assert announced.count("compiling") == 1


def test_what_is_cached_is_not_announced(cache: Path) -> None:
    assert run(SAY + "print(say())", cache) == ("False\n", "")


@pytest.mark.parametrize(
    ("suffix", "damaged"),
    [
        ("nbi", lambda data: b""),
        ("nbi", lambda data: data[: len(data) // 2]),
        ("nbc", lambda data: data[:-9] + b"x" * 9),
    ],
    ids=["empty", "cut", "overwritten"],
)
def test_a_damaged_file_costs_one_line_and_a_compilation(cache: Path, suffix: str, damaged) -> None:
    files = list(cache.rglob(f"*.{suffix}"))
    for file in files:
        file.write_bytes(damaged(file.read_bytes()))
        os.utime(file, (0, 0))
    said, line = run(STEP, cache)
    assert said == "True\n"
    assert line.count("\n") == 1 and f"{len(files)} damaged files" in line
    assert run(STEP, cache) == ("True\n", "")


@pytest.mark.parametrize("content", [b"{", b'{"a": 1}'])
def test_damaged_records_of_files_cost_nothing(cache: Path, content: bytes) -> None:
    (record,) = cache.rglob("digests.json")
    record.write_bytes(content)
    assert run(STEP, cache) == ("True\n", "")


def test_where_nothing_can_be_kept_loops_are_compiled_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "slam_gym").write_text("a file where the folder should be")
    said, announced = run(STEP + SAY + "print(say())", tmp_path)
    assert said == "True\nFalse\n" and "nothing can be kept" in announced


def test_without_compilation_an_episode_is_the_same_but_for_rounding() -> None:
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
