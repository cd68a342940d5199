"""The update's linear algebra against numpy's, and what is no covariance."""

import numpy as np
import pytest

from slam_gym.mapping.linear_algebra import (
    aligned_zeros,
    cholesky,
    is_covariance,
    padded,
    read_only,
    subtract_squares,
    whiten,
)
from slam_gym.types import Array

SIZES = [1, 2, 3, 8, 21]


def definite(rng: np.random.Generator, n: int) -> Array:
    factor = rng.standard_normal((n, n))
    return factor @ factor.T + 0.1 * np.eye(n)


@pytest.mark.parametrize("n", SIZES)
def test_cholesky_equals_numpy_and_reads_the_lower_triangle_alone(n: int) -> None:
    rng = np.random.default_rng(n)
    A = definite(rng, n)
    given = np.tril(A) + np.triu(np.full((n, n), np.nan), 1)
    assert cholesky(given)
    np.testing.assert_allclose(np.tril(given), np.linalg.cholesky(A), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("A", [-np.eye(2), np.zeros((2, 2)), np.diag([1.0, np.nan]), np.diag([np.inf, 1.0])])
def test_what_is_not_positive_definite_has_no_cholesky_factor(A: Array) -> None:
    assert not cholesky(A.copy())


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


@pytest.mark.parametrize(("pairings", "d"), [(1, 3), (2, 11), (5, 40)])
def test_whitening_solves_both_right_hand_sides(pairings: int, d: int) -> None:
    rng = np.random.default_rng(d)
    L = np.linalg.cholesky(definite(rng, 2 * pairings))
    B, nu = np.zeros((2 * pairings, padded(d))), rng.standard_normal(2 * pairings)
    B[:, :d] = rng.standard_normal((2 * pairings, d))
    W, y = B.copy(), nu.copy()
    whiten(L, W, y)
    np.testing.assert_allclose(L @ W, B, atol=1e-12)
    np.testing.assert_allclose(L @ y, nu, atol=1e-12)
    assert not W[:, d:].any()


@pytest.mark.parametrize(("pairings", "d"), [(1, 3), (2, 11), (5, 40), (3, 96)])
def test_the_product_is_subtracted_from_the_upper_triangle(pairings: int, d: int) -> None:
    rng = np.random.default_rng(d)
    W, side = np.zeros((2 * pairings, padded(d))), padded(d)
    W[:, :d] = rng.standard_normal((2 * pairings, d))
    P = aligned_zeros(side, side)
    P[:d, :d] = definite(rng, d)
    before = P.copy()
    subtract_squares(P, W)
    np.testing.assert_allclose(np.triu(P), np.triu(before - W.T @ W), rtol=0, atol=1e-11)


# --- what is handed on ------------------------------------------------------------------------------------------------


def test_a_read_only_array_goes_on_with_its_source_and_is_no_way_to_write_to_it() -> None:
    for array in (np.arange(6.0).reshape(3, 2), np.zeros((0, 2)), np.array([True, False]), np.arange(6.0)[::2]):
        locked = read_only(array)
        array[...] = 1
        assert np.array_equal(locked, array) and locked.dtype == array.dtype
        assert not isinstance(locked.base, np.ndarray)
        for each in (locked, locked[:], read_only(locked)):
            with pytest.raises(ValueError, match="WRITEABLE"):
                each.flags.writeable = True
