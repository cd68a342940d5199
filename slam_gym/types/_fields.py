"""Types of arrays, and conversion of what users pass in: fresh arrays of a known shape, or a clear error."""

import math
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Entry = TypeVar("Entry", bound=np.generic)

FLOAT, INTEGER = np.dtype(np.float64), np.dtype(np.int64)
_SPECIAL = (np.ma.MaskedArray, np.matrix)  # arrays that mean something else than plain ones

UNKNOWN_KIND = -2
"""The kind of a measurement or feature that could not be classified."""


def check_array(name: str, value: object, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    """Raise ValueError unless `value` is an array of this type and shape."""
    if not isinstance(value, np.ndarray) or isinstance(value, _SPECIAL) or value.dtype != dtype:
        is_special = not isinstance(value, np.ndarray) or isinstance(value, _SPECIAL)
        actual = type(value).__name__ if is_special else value.dtype  # type: ignore[attr-defined]
        raise ValueError(
            f"{name}: {actual}, expected an array of {dtype} (the class methods from_… convert other types)"
        )
    if value.shape != shape:
        raise ValueError(f"{name}: shape {value.shape}, expected {shape}")


def floats(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """A fresh float array of `shape`, where −1 stands for any length. Raises ValueError naming the argument."""
    _refuse_special(name, value)
    try:
        out = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected numbers of shape {_formatted(shape)}, got {value!r}") from error
    if out.shape == (0,) and shape and shape[0] in (-1, 0):  # an empty list has no further dimensions
        out = out.reshape(0, *shape[1:])
    if out.ndim != len(shape) or any(side != -1 and side != actual for side, actual in zip(shape, out.shape)):
        raise ValueError(f"{name}: shape {out.shape}, expected {_formatted(shape)}")
    return out


def deviations(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Standard deviations of `shape`, from an array of that shape or one number for all. Raises ValueError naming the
    argument."""
    _refuse_special(name, value)
    sigmas = np.asarray(value, np.float64)
    if sigmas.shape not in ((), shape):
        raise ValueError(f"{name}: shape {sigmas.shape}, expected one number or {_formatted(shape)}")
    if (sigmas < 0.0).any():
        raise ValueError(f"{name}: {sigmas.min():g} is negative; expected standard deviations")
    return np.broadcast_to(sigmas, shape)


def in_radians(name: str, angles: Array) -> Array:
    """`angles` unchanged. Raises ValueError where one is more than a full turn: it is probably in degrees."""
    if (np.abs(angles) > 2.0 * math.pi).any():
        largest = angles.flat[np.abs(angles).argmax()]
        raise ValueError(f"{name}: {largest:g} rad is more than a turn; are these degrees? (numpy.deg2rad)")
    return angles


def _refuse_special(name: str, value: ArrayLike) -> None:
    """Raise ValueError for arrays that would lose something as plain ones: a mask, imaginary parts, matrix products."""
    is_complex = isinstance(value, np.ndarray) and value.dtype.kind == "c"
    if isinstance(value, _SPECIAL) or is_complex:
        what = "complex numbers" if is_complex else type(value).__name__
        raise ValueError(f"{name}: {what}, expected a plain array of real numbers")


def _formatted(shape: tuple[int, ...]) -> str:
    return str(shape).replace("-1", "m")


def covariances_of(name: str, value: ArrayLike | None, sigma: ArrayLike | None, m: int) -> Array:
    """Covariances (m, 2, 2), from either covariances or standard deviations, for each measurement or one for all.
    Raises ValueError unless exactly one of the two is given."""
    if (value is None) == (sigma is None):
        raise ValueError(f"{name}, sigma: expected exactly one of the two")
    if value is not None:
        _refuse_special(name, value)
        covariances = np.asarray(value, np.float64)
        if covariances.shape not in ((2, 2), (m, 2, 2)):
            raise ValueError(f"{name}: shape {covariances.shape}, expected ({m}, 2, 2) or (2, 2)")
        return np.array(np.broadcast_to(covariances, (m, 2, 2)), order="C")
    assert sigma is not None
    return deviations("sigma", sigma, (m,))[:, None, None] ** 2 * np.eye(2)


def sizes_of(sizes: ArrayLike | None, sigma: ArrayLike | None, m: int) -> tuple[Array, Array]:
    """Sizes (m,) [m] and their variances (m,) [m²], NaN where unknown. Raises ValueError naming the argument."""
    if (sizes is None) != (sigma is None):
        raise ValueError("sizes, size_sigma: expected both or neither")
    if sizes is None or sigma is None:
        return np.full(m, np.nan), np.full(m, np.nan)
    known = floats("sizes", sizes, (m,))
    return known, np.where(np.isnan(known), np.nan, deviations("size_sigma", sigma, (m,)) ** 2)


def kinds_of(kinds: ArrayLike | None, m: int) -> IntArray:
    if kinds is None:
        return np.full(m, UNKNOWN_KIND)
    _refuse_special("kinds", kinds)
    array = np.array(kinds, np.int64 if m == 0 and np.size(kinds) == 0 else None)
    if array.shape != (m,) or not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"kinds: {array.dtype} of shape {array.shape}, expected ({m},) integers")
    array = array.astype(np.int64)
    if ((array < 0) & (array != UNKNOWN_KIND)).any():
        raise ValueError(f"kinds: {array.min()}, expected numbers from 0, or {UNKNOWN_KIND} where a kind is unknown")
    return array


def locked(array: NDArray[Entry]) -> NDArray[Entry]:
    """The array, which cannot be written to by this view."""
    view = array.view()
    view.flags.writeable = False
    return view


def compact(array: NDArray[Entry]) -> NDArray[Entry]:
    """The array as loops are compiled for: C-contiguous, and marked writeable. They do not write to it."""
    view = np.ascontiguousarray(array).view()
    try:
        view.flags.writeable = True
    except ValueError:  # its memory is read-only
        return view.copy()
    return view
