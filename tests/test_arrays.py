"""Sorting within kernels, against numpy's stable sort."""

import numpy as np
import pytest

from slam_gym._arrays import ascending


@pytest.mark.parametrize("n", [0, 1, 2, 3, 7, 8, 9, 100, 1000])
def test_ascending_and_stable(n: int) -> None:
    for values in (np.random.default_rng(n).random(n), np.random.default_rng(n).integers(0, 5, n).astype(np.float64)):
        before = values.copy()
        assert np.array_equal(ascending(values), np.argsort(values, kind="stable"))
        assert np.array_equal(values, before)
