"""Kernels that call kernels."""

import pickle
from typing import Any

import pytest

from slam_gym._compile import compiled


@compiled
def _root(x: float) -> float:
    if x < 0.0:
        raise ValueError("no root of a negative number")
    return float(x**0.5)


@compiled
def _sum_of_roots(x: float, count: int) -> float:
    total = 0.0
    for _ in range(count):
        total += _root(x)
    return total


@compiled
def _twice(x: float) -> float:
    return 2.0 * _sum_of_roots(x, 3)


def signatures() -> list[int]:
    """For how many types of arguments each of the kernels can be called from Python."""
    kernels: list[Any] = [_twice, _sum_of_roots, _root]
    return [len(kernel.signatures) for kernel in kernels]


def test_machine_code_is_made_of_what_python_calls() -> None:
    assert _twice(4.0) == 12.0
    assert signatures() == [1, 0, 0]
    assert (_root(9.0), _sum_of_roots(9.0, 2)) == (3.0, 6.0)
    assert signatures() == [1, 1, 1]


def test_errors_come_through_from_within() -> None:
    for kernel in (_twice, _root):
        with pytest.raises(ValueError, match="no root of a negative number"):
            kernel(-1.0)


def test_kernels_are_pickled_by_what_they_are() -> None:
    assert pickle.loads(pickle.dumps(_twice))(4.0) == 12.0
