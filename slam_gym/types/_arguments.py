"""What users hand in as arrays, taken apart: lists and numbers become fresh arrays of known shape, or a clear error."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FLOAT, INTEGER = np.dtype(np.float64), np.dtype(np.int64)

UNKNOWN_KIND = -2
"""The kind of what could not be classified."""


def check_array(name: str, given: object, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    """Raise ValueError where that is no array of this type and shape."""
    if not isinstance(given, np.ndarray) or given.dtype != dtype:
        told = given.dtype if isinstance(given, np.ndarray) else type(given).__name__
        raise ValueError(f"{name}: {told}, expected an array of {dtype} (the class methods from_… take anything)")
    if given.shape != shape:
        raise ValueError(f"{name}: shape {given.shape}, expected {shape}")


def floats(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """A fresh float array of that shape, −1 standing for any length. Raises ValueError naming the argument."""
    try:
        out = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected numbers of shape {_spoken(shape)}, got {value!r}") from error
    if out.ndim == 1 and out.size == 0 and shape[0] in (-1, 0):  # an empty list tells no further dimensions
        out = out.reshape(0, *shape[1:])
    if out.ndim != len(shape) or any(given != -1 and given != found for given, found in zip(shape, out.shape)):
        raise ValueError(f"{name}: shape {out.shape}, expected {_spoken(shape)}")
    return out


def deviations(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Standard deviations of that shape, from as many or from one for all. Raises ValueError naming the argument."""
    given = np.asarray(value, np.float64)
    if given.shape not in ((), shape):
        raise ValueError(f"{name}: shape {given.shape}, expected one number or {_spoken(shape)}")
    if (given < 0.0).any():
        raise ValueError(f"{name}: {given.min():g} is negative, and no standard deviation")
    return np.broadcast_to(given, shape)


def in_radians(name: str, angles: Array) -> Array:
    """The same angles. Raises ValueError where one is more than a turn: degrees, very likely."""
    if (np.abs(angles) > 2.0 * math.pi).any():
        far = angles.flat[np.abs(angles).argmax()]
        raise ValueError(f"{name}: {far:g} rad is more than a turn; are these degrees? (numpy.deg2rad)")
    return angles


def _spoken(shape: tuple[int, ...]) -> str:
    return "(" + ", ".join("m" if side == -1 else str(side) for side in shape) + ("," if len(shape) == 1 else "") + ")"


def covariances_of(name: str, value: ArrayLike | None, sigma: ArrayLike | None, m: int) -> Array:
    """(m, 2, 2) from exactly one of covariances, for each or for all, and standard deviations."""
    if (value is None) == (sigma is None):
        raise ValueError(f"{name}, sigma: expected exactly one of the two")
    if value is not None:
        given = np.asarray(value, np.float64)
        if given.shape not in ((2, 2), (m, 2, 2)):
            raise ValueError(f"{name}: shape {given.shape}, expected ({m}, 2, 2) or (2, 2)")
        return np.array(np.broadcast_to(given, (m, 2, 2)), order="C")
    assert sigma is not None
    return deviations("sigma", sigma, (m,))[:, None, None] ** 2 * np.eye(2)


def sizes_of(sizes: ArrayLike | None, sigma: ArrayLike | None, m: int) -> tuple[Array, Array]:
    """Sizes (m,) and their variances (m,), NaN where unknown."""
    if (sizes is None) != (sigma is None):
        raise ValueError("sizes, size_sigma: expected both or neither")
    if sizes is None or sigma is None:
        return np.full(m, np.nan), np.full(m, np.nan)
    given = floats("sizes", sizes, (m,))
    return given, np.where(np.isnan(given), np.nan, deviations("size_sigma", sigma, (m,)) ** 2)


def kinds_of(kinds: ArrayLike | None, m: int) -> IntArray:
    if kinds is None:
        return np.full(m, UNKNOWN_KIND)
    given = np.array(kinds)
    if given.shape != (m,) or not np.issubdtype(given.dtype, np.integer):
        raise ValueError(f"kinds: {given.dtype} of shape {given.shape}, expected ({m},) integers")
    return given.astype(np.int64)
