"""The long run in its shortest form: a few episodes with extreme settings."""

import numpy as np
import pytest

from benchmarks.long_run import check_covariance, checked, episode


@pytest.mark.parametrize("number", (0, 1, 5, 8, 14, 29))
def test_nothing_breaks(number: int) -> None:
    words, env = episode(number, 0, 24)
    assert sum(checked(env, number)) > 0, words


def test_covariances_that_are_none_are_told_from_those_that_are() -> None:
    root = np.random.default_rng(0).standard_normal((9, 5))
    good, scale = root @ root.T, np.diag(10.0 ** np.arange(-4, 5))  # of rank five
    for covariance in (good, scale @ good @ scale, np.zeros((3, 3))):
        check_covariance(covariance)
    for wrong in (good - 1e-3 * np.eye(9), np.diag([1.0, -1e-12]), np.full((2, 2), np.nan), np.triu(good)):
        with pytest.raises(AssertionError):
            check_covariance(wrong)
