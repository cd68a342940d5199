"""Settings of recordings go by what kind of log it is."""

from dataclasses import replace

import pytest

from slam_gym.recordings import Recording
from slam_gym.scenarios.recorded import GENERIC, MRCLAM, VICTORIA_PARK, slam_for
from tests.recordings.test_recording import by_hand


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("victoria_park", VICTORIA_PARK),
        ("mrclam/MRCLAM_Dataset6/robot3", MRCLAM),
        ("mine", GENERIC),
        ("mine/mrclam", GENERIC),
    ],
)
def test_the_first_part_of_the_name_decides(name, settings) -> None:
    assert slam_for(replace(Recording(**by_hand()), name=name)) == settings


def test_a_log_that_nobody_knows_reaches_as_far_as_it_measures() -> None:
    assert GENERIC.reach is None
