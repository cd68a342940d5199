"""Relocation under locality is linear in the map: what is tested, and how large localities are."""

import numpy as np
import pytest

from benchmarks.locality import inside, losses, surveyed_field
from slam_gym import gcbb
from slam_gym.mapping.locality import locality_sizes


@pytest.mark.parametrize("name", ["covisibility", "within 2r"])
def test_the_first_pairing_tests_every_feature_once_and_all_others_only_its_locality(name: str) -> None:
    rng = np.random.default_rng(3)
    area = surveyed_field(300, rng)
    local = area.locality(name)
    for _ in range(5):
        effort = gcbb(inside(area, 6, 1, rng).scan, area.landmarks, local).effort
        assert effort.unary_tests <= 6 * 300 + effort.nodes * locality_sizes(local, 300).max()


@pytest.mark.parametrize("name", ["covisibility", "two hops", "within 2r", "local maps"])
def test_localities_do_not_grow_with_the_map(name: str) -> None:
    areas = {n: surveyed_field(n, np.random.default_rng(n)) for n in (400, 1600)}
    small, large = (locality_sizes(area.locality(name), n).mean() for n, area in areas.items())
    assert large < 1.25 * small


def test_covisibility_loses_what_two_hops_and_distance_find() -> None:
    rng = np.random.default_rng(7)
    area = surveyed_field(200, rng)
    truths = [inside(area, 8, 2, rng).truth for _ in range(40)]
    lost = {
        name: losses(truths, area.locality(name)) for name in ("everything", "within 2r", "two hops", "covisibility")
    }
    assert set(lost["everything"].values()) == {0.0}
    assert lost["within 2r"]["pairs"] < 0.01 < lost["covisibility"]["pairs"] < 0.3
    assert lost["two hops"]["pairs"] < 0.2 * lost["covisibility"]["pairs"]
