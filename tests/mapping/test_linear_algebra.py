"""What is a covariance, and arrays that cannot be written to; `test_ekf` holds the update to a textbook's."""

import numpy as np
import pytest

from slam_gym.mapping.linear_algebra import is_covariance, read_only
from slam_gym.types import Array

SIZES = [1, 2, 3, 8, 21]


def definite(rng: np.random.Generator, n: int) -> Array:
    factor = rng.standard_normal((n, n))
    return factor @ factor.T + 0.1 * np.eye(n)


@pytest.mark.parametrize("n", SIZES)
def test_a_covariance_is_finite_symmetric_and_psd(n: int) -> None:
    rng = np.random.default_rng(n)
    A = definite(rng, n)
    assert is_covariance(A) and is_covariance(np.zeros((n, n)))
    flat = rng.standard_normal((n, 1))
    assert is_covariance(flat @ flat.T)  # singular, yet a covariance
    assert not is_covariance(-A)
    for bad in (np.nan, np.inf):
        spoilt = A.copy()
        spoilt[n - 1, 0] = spoilt[0, n - 1] = bad
        assert not is_covariance(spoilt)


def test_a_covariance_may_miss_symmetry_and_definiteness_by_rounding_only() -> None:
    A = np.diag([1.0, 4.0, 9.0])
    for entry, slight, much in (((0, 1), 1e-10, 1e-6), ((2, 0), 1e-10, 1e-6)):
        for change, fine in ((slight, True), (much, False)):
            B = A.copy()
            B[entry] += change
            assert is_covariance(B) is fine
    assert is_covariance(np.diag([1.0, -1e-10])) and not is_covariance(np.diag([1.0, -1e-6]))


def test_a_read_only_array_goes_on_with_its_source_and_is_no_way_to_write_to_it() -> None:
    for array in (np.arange(6.0).reshape(3, 2), np.zeros((0, 2)), np.array([True, False]), np.arange(6.0)[::2]):
        locked = read_only(array)
        array[...] = 1
        assert np.array_equal(locked, array) and locked.dtype == array.dtype
        assert not isinstance(locked.base, np.ndarray)
        for each in (locked, locked[:], read_only(locked)):
            with pytest.raises(ValueError, match="WRITEABLE"):
                each.flags.writeable = True
