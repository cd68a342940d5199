"""The public face: what it lists is there, and importing it is cheap."""

import subprocess
import sys

import pytest

import slam_gym


def test_everything_listed_is_there_and_listed_once() -> None:
    assert len(set(slam_gym.__all__)) == len(slam_gym.__all__)
    for name in slam_gym.__all__:
        assert getattr(slam_gym, name) is not None
    assert set(slam_gym.__all__) <= set(dir(slam_gym))


def test_what_is_not_there_says_so() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        slam_gym.nonsense  # noqa: B018


def test_importing_the_package_imports_nothing_heavy() -> None:
    heavy = ("numba", "scipy", "pymunk", "torch", "pygame")
    code = f"import sys, slam_gym; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
