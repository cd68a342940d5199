"""The figures of recordings: maps over the reference, errors over time."""

import numpy as np
import pytest

from agents.reports.log_figures import errors_over_time, maps
from tests.agents.reports import PNG


@pytest.fixture
def errors():
    time, rng = np.linspace(0.0, 10.0, 50), np.random.default_rng(0)
    return {
        name: {"time": time, "x": time, "y": np.sin(time), "reference_x": time, "reference_y": np.cos(time),
               "error": rng.random(50)}
        for name in ("jcbb", "singles", "true_association")
    }  # fmt: skip


@pytest.mark.parametrize("landmarks", [np.empty((0, 2)), np.array([[1.0, 2.0], [3.0, -1.0]])])
def test_maps_are_drawn_with_every_kind_of_feature(errors, landmarks):
    features = {"identity": np.array([4.0, 4.0, -1.0, -2.0]), "confirmed": np.array([1.0, 1.0, 1.0, 0.0]),
                "x": np.arange(4.0), "y": np.zeros(4)}  # fmt: skip
    assert maps(errors, dict.fromkeys(errors, features), landmarks).startswith(PNG)


@pytest.mark.parametrize("jump", [0.0, 500.0])
def test_errors_are_drawn_even_where_the_reference_jumps(errors, jump):
    errors["jcbb"]["error"][7] += jump
    assert errors_over_time(errors).startswith(PNG)
