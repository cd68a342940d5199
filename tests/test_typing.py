"""That numba finds what it finds without being asked twice."""

from typing import Any

import numpy as np
from numba.core.types.functions import BaseFunction

from slam_gym._compile import compiled
from slam_gym._typing import resolved_once


@compiled
def _mixed(x: Any, k: int) -> Any:
    return (x + x) * k + x + k // 2


def test_operators_are_told_apart_by_their_types() -> None:
    """The same ones on integers, floats and arrays, within one kernel and between several."""
    assert _mixed(1, 3) == 8 and isinstance(_mixed(1, 3), int)
    assert _mixed(0.5, 3) == 4.5
    assert _mixed(np.array([0.5, 1.0]), 3).tolist() == [4.5, 8.0]
    assert _mixed(np.array([1, 2]), 3).dtype == np.int64


def test_numba_is_left_as_it_was() -> None:
    cls: Any = BaseFunction
    before = cls.get_call_type
    with resolved_once(), resolved_once():
        assert cls.get_call_type is not before
    assert cls.get_call_type is before
