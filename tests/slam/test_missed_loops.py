"""A robot says when it maps a place for the second time."""

import numpy as np
import pytest

from slam_gym.slam.slam import Slam, SlamSpec
from tests.slam.rings import REACH, VIEW, drive, duplicates, map_it, ring_of_landmarks


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("carried_at", [None, 200])
def test_a_loop_is_missed_where_the_map_shows_a_place_twice_and_nowhere_else(carried_at: int | None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    log = drive(ring_of_landmarks(rng), rng, steps=450, drift=0.001, carried_at=carried_at)
    slam, blind = Slam(SlamSpec(reach=REACH), VIEW), Slam(SlamSpec(reach=REACH))
    twice = duplicates(map_it(slam, log)[0])
    map_it(blind, log)
    assert [slam.missed_loop, twice > 10, blind.missed_loop] == [carried_at is not None] * 2 + [False]
