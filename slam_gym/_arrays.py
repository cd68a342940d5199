"""Sorting and copying within kernels: numba's own sorts, and its assignment of arrays to slices, which checks their
shapes, take longer to compile than the kernels that use them."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from slam_gym._jit import compiled, inlined
from slam_gym.types import Array, IntArray

Entry = TypeVar("Entry", bound=np.generic)


@inlined
def fill_from(target: NDArray[Entry], source: NDArray[Entry]) -> None:
    """The first entries of `target` (≥ n,) become `source` (n,)."""
    for i in range(len(source)):
        target[i] = source[i]


@compiled
def ascending(values: Array) -> IntArray:
    """The indices (n,) of the values (n,) in ascending order, equal ones as they come: a merge sort from below."""
    n, width = len(values), 1
    order, merged = np.arange(n), np.empty(n, np.int64)
    while width < n:
        for low in range(0, n, 2 * width):
            middle, high = min(low + width, n), min(low + 2 * width, n)
            p, q = low, middle
            for at in range(low, high):
                if p < middle and (q == high or not values[order[q]] < values[order[p]]):
                    merged[at] = order[p]
                    p += 1
                else:
                    merged[at] = order[q]
                    q += 1
        order, merged, width = merged, order, 2 * width
    return order
