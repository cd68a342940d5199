"""Users' arrays: what they become, that nothing is shared, and that what does not fit is named."""

import numpy as np
import pytest

from slam_gym.types._arguments import UNKNOWN_KIND, covariances_of, floats, kinds_of, points_of, sizes_of


@pytest.mark.parametrize("value", [[1, 2, 3], (1, 2, 3), np.arange(1, 4, dtype=np.int32), np.float32([1, 2, 3])])
def test_whatever_holds_numbers_becomes_a_fresh_array_of_doubles(value) -> None:
    out = floats("x", value, (3,))
    assert out.dtype == np.float64 and out.flags.c_contiguous and out.tolist() == [1.0, 2.0, 3.0]
    assert not np.shares_memory(out, np.asarray(value))


def test_an_array_of_doubles_is_copied_too_into_rows_however_it_lies_in_memory() -> None:
    """Compiled functions would be compiled anew for another order."""
    given = np.arange(6.0).reshape(3, 2).T
    out = floats("x", given, (2, 3))
    out[0, 0] = 9.0
    assert given[0, 0] == 0.0 and out.flags.c_contiguous
    covariances = np.asfortranarray(np.tile(np.eye(2), (3, 1, 1)))
    assert covariances_of("covariances", covariances, None, 3).flags.c_contiguous
    assert covariances_of("covariances", covariances[0], None, 3).flags.c_contiguous


@pytest.mark.parametrize(
    ("value", "shape", "message"),
    [
        ([1, 2], (3,), r"^x: shape \(2,\), expected \(3,\)$"),
        ([1, 2], (-1, 2), r"^x: shape \(2,\), expected \(m, 2\)$"),
        (5.0, (-1,), r"^x: shape \(\), expected \(m,\)$"),
        ([[1, 2, 3]], (-1, 2), r"^x: shape \(1, 3\), expected \(m, 2\)$"),
        (["one"], (1,), "^x: expected numbers"),
        ([[1, 2], [3]], (2, 2), "^x: expected numbers"),
    ],
)
def test_what_is_no_such_array_is_named(value, shape, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        floats("x", value, shape)


@pytest.mark.parametrize("nothing", [[], (), np.empty(0), np.empty((0, 2))])
def test_an_empty_list_is_no_point(nothing) -> None:
    assert points_of("points", nothing).shape == (0, 2)


def test_a_covariance_for_all_is_one_for_each() -> None:
    one = np.array([[2.0, 0.5], [0.5, 1.0]])
    out = covariances_of("covariances", one, None, 3)
    np.testing.assert_array_equal(out, [one] * 3)
    out[0] = 0.0  # each its own
    assert (out[1] == one).all() and one[0, 0] == 2.0


def test_a_standard_deviation_is_the_same_in_both_directions() -> None:
    np.testing.assert_array_equal(covariances_of("covariances", None, 0.5, 2), [0.25 * np.eye(2)] * 2)
    each = covariances_of("covariances", None, [0.5, 2.0], 2)
    np.testing.assert_array_equal(each, [0.25 * np.eye(2), 4.0 * np.eye(2)])
    assert covariances_of("covariances", None, 0.5, 0).shape == (0, 2, 2)


@pytest.mark.parametrize(
    ("value", "sigma", "message"),
    [
        (None, None, "covariances, sigma: expected exactly one"),
        (np.eye(2), 0.1, "covariances, sigma: expected exactly one"),
        (np.ones(2), None, r"covariances: shape \(2,\), expected \(2, 2, 2\) or \(2, 2\)"),
        (np.ones((3, 2, 2)), None, r"covariances: shape \(3, 2, 2\), expected \(2, 2, 2\)"),
        (None, [0.1, 0.2, 0.3], r"sigma: shape \(3,\), expected one number or \(2,\)"),
    ],
)
def test_covariances_that_do_not_fit_are_named(value, sigma, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        covariances_of("covariances", value, sigma, 2)


def test_sizes_come_with_their_variances_and_are_unknown_where_they_are_not_numbers() -> None:
    sizes, variances = sizes_of([0.3, np.nan, 0.5], 0.1, 3)
    np.testing.assert_array_equal(sizes, [0.3, np.nan, 0.5])
    np.testing.assert_allclose(variances, [0.01, np.nan, 0.01])
    np.testing.assert_allclose(sizes_of([0.3, 0.4], [0.1, 0.2], 2)[1], [0.01, 0.04])
    for unknown in sizes_of(None, None, 2):
        assert np.isnan(unknown).all() and unknown.shape == (2,)


@pytest.mark.parametrize(
    ("sizes", "sigma", "message"),
    [
        ([0.1, 0.2], None, "both or neither"),
        (None, 0.1, "both or neither"),
        ([0.1], 0.1, r"sizes: shape \(1,\), expected \(2,\)"),
        ([0.1, 0.2], [0.1], r"size_sigma: shape \(1,\), expected one number or \(2,\)"),
    ],
)
def test_sizes_that_do_not_fit_are_named(sizes, sigma, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sizes_of(sizes, sigma, 2)


def test_kinds_are_integers_and_unknown_where_nobody_tells() -> None:
    assert kinds_of(None, 2).tolist() == [UNKNOWN_KIND] * 2
    given = np.array([3, UNKNOWN_KIND], np.int16)
    out = kinds_of(given, 2)
    assert out.dtype == np.int64 and out.tolist() == [3, UNKNOWN_KIND] and not np.shares_memory(out, given)
    for bad in ([0.5, 1.0], [1], [[1, 2]], ["door", "wall"]):
        with pytest.raises(ValueError, match=r"kinds: .* expected \(2,\) integers"):
            kinds_of(bad, 2)
