"""Compiled loops: announced where they are due, kept, and made again where what was kept is damaged."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

STEP = """
import numpy as np
from slam_gym.mapping import ekf, linear_algebra
linear_algebra.subtract_squares(np.eye(16), np.zeros((2, 16)))
print(linear_algebra.cholesky(4.0 * np.eye(3)))
"""


def run(code: str, cache: Path) -> tuple[str, str]:
    """What a fresh process prints and says on stderr."""
    command, environment = [sys.executable, "-c", code], os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    return done.stdout, done.stderr


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A cache in which there is what STEP calls, and what was told while it was compiled."""
    folder = tmp_path_factory.mktemp("compiled")
    said, told = run(STEP, folder)
    assert said == "True\n" and list(folder.rglob("*.nbi"))
    return folder, told


@pytest.fixture
def cache(compiled: tuple[Path, str], tmp_path: Path) -> Path:
    return Path(shutil.copytree(compiled[0], tmp_path / "cache"))


def test_what_is_compiled_is_told(compiled: tuple[Path, str]) -> None:
    _, told = compiled
    assert "compiles its inner loops, once: " in told and " 0 of up to " in told
    assert ", subtract_squares" in told or ", subtract_from" in told  # which it calls


def test_what_is_cached_is_not_told_nor_is_what_others_compile(cache: Path) -> None:
    own = "import numba\n@numba.njit\ndef twice(x):\n    return 2 * x\n"
    assert run(own + STEP + "print(twice(2))", cache) == ("True\n4\n", "")
    told = run(STEP + "ekf.predict(np.zeros(8), np.eye(8), 3, np.zeros(3), np.eye(3))", cache)[1]
    assert "compiles its inner loops" in told and ", predict" in told  # only some of what is needed is cached


def test_installations_of_the_same_sources_share_what_is_cached(cache: Path, tmp_path: Path, monkeypatch) -> None:
    shutil.copytree(Path(__file__).parents[1] / "slam_gym", tmp_path / "other" / "slam_gym")
    (tmp_path / "other" / "slam_gym" / "shipped").mkdir()
    (tmp_path / "other" / "slam_gym" / "shipped" / "agent.py").touch()  # as in a wheel
    monkeypatch.chdir(tmp_path / "other")
    said, told = run(STEP + "print(linear_algebra.__file__)", cache)
    assert said == f"True\n{tmp_path}/other/slam_gym/mapping/linear_algebra.py\n" and told == ""


def test_other_versions_of_numba_and_other_directories_do_not_compile_again(cache: Path, monkeypatch) -> None:
    monkeypatch.chdir(cache.parent)
    assert "compiles its inner loops" in run("import numba\nnumba.__version__ = 'other'\n" + STEP, Path("cache"))[1]
    assert run("import os, slam_gym.geometry\nos.chdir('/')\n" + STEP, Path("cache")) == ("True\n", "")


@pytest.mark.parametrize(
    ("suffix", "damaged"),
    [("nbi", lambda data: data[: len(data) // 2]), ("nbc", lambda data: data[:-9] + b"x" * 9)],
    ids=["cut", "overwritten"],
)
def test_a_damaged_file_costs_a_line_and_a_compilation(cache: Path, suffix: str, damaged) -> None:
    files = list(cache.rglob(f"*.{suffix}"))
    for file in files:
        file.write_bytes(damaged(file.read_bytes()))
        os.utime(file, (0, 0))
    said, told = run(STEP, cache)
    assert said == "True\n"
    assert f"{len(files)} damaged files" in told and "compiles its inner loops" in told
    assert run(STEP, cache) == ("True\n", "")


@pytest.mark.parametrize("content", [b"{", b'{"a": 1}'])
def test_damaged_records_of_files_cost_nothing(cache: Path, content: bytes) -> None:
    (record,) = cache.rglob("digests.json")
    record.write_bytes(content)
    assert run(STEP, cache) == ("True\n", "")


def test_where_nothing_can_be_kept_loops_are_compiled_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "slam_gym").write_text("a file where the folder should be")
    said, told = run(STEP, tmp_path)
    assert said == "True\n" and "at every start, as nothing can be kept" in told


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
