"""The public face: what it lists is there, and importing it is cheap."""

import subprocess
import sys

import numpy as np
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


def test_slam_on_arrays_of_one_s_own() -> None:
    slam, world = slam_gym.Slam(), np.array([[2.0, 1.0], [3.0, -1.0], [5.0, 0.5]])
    for k in range(5):
        odometry = slam_gym.Odometry.from_motion([0.5 if k else 0.0, 0, 0], [0.02, 0.02, 0.01])
        slam.step(odometry, slam_gym.Scan.from_points(world - [0.5 * k, 0], sigma=0.05), "jcbb")
    assert len(slam.map) == 3 and "3 features" in repr(slam)
    np.testing.assert_allclose(slam.map.pose, [2.0, 0.0, 0.0], atol=0.1)
