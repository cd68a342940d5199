"""Maps that SLAM made, and what scans in them should be paired with."""

import numpy as np

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.bench.feature_index.slam_maps import (
    SlamMap,
    corridors,
    fields,
    grown_index,
    in_map,
    mostly_right,
    offices,
    relocate_all,
)
from slam_gym.types import SPURIOUS, UNPAIRED, Effort, Relocation


def test_sources_are_looked_up_in_the_map_and_clutter_never_is():
    identities = np.array([4, SPURIOUS, 7, 4])
    assert in_map(np.array([7, 4, 5, SPURIOUS]), identities).tolist() == [2, 3, UNPAIRED, UNPAIRED]


def test_right_is_what_pairs_half_of_the_known():
    truth = np.array([0, 1, 2, 3, UNPAIRED])

    def answer(*features):
        return Relocation(np.array(features), np.zeros(3), np.eye(3), 0.0, 1, 3, False, 0, Effort())

    assert mostly_right(answer(0, 1, -1, -1, 4), truth) and not mostly_right(answer(0, -1, -1, 5, -1), truth)
    assert not mostly_right(answer(-1, -1), np.array([UNPAIRED, UNPAIRED]))


def test_scans_of_a_field_are_found_in_its_map_by_either_index():
    made = fields(1, np.random.default_rng(0))
    assert len(made[0].scans) == 10
    for make in (FeatureIndex, grown_index):
        found = relocate_all(made, make)
        assert found["scans"] == 10 and found["right"] >= 0.8 and found["wrong"] == 0.0
        assert grown_index(made[0].landmarks).n == len(made[0].landmarks)


def test_maps_come_with_scans_that_were_not_used_to_make_them():
    (corridor,), (office,) = corridors(1), offices(1)
    assert len(corridor.scans) == 12 and 80 < len(corridor.landmarks) < 100
    assert 10 <= len(office.scans) <= 20
    for made in (corridor, office):
        assert isinstance(made, SlamMap)
        known = np.concatenate([truth for _, truth in made.scans])
        assert (known != UNPAIRED).mean() > 0.8 and known.max() < len(made.landmarks)
