"""Memory that a process holds."""

import math

import numpy as np

from slam_gym.bench.memory import resident


def test_what_is_held_is_counted() -> None:
    before = resident()
    held = np.ones(10_000_000)
    grown = resident() - before
    assert math.isnan(before) or 70.0 < grown < 90.0
    assert held[-1] == 1.0
