"""What hypotheses and relocations say of themselves."""

from dataclasses import replace

import numpy as np

from slam_gym.types import UNPAIRED, Effort, Hypothesis, Relocation

FEATURES = np.array([4, UNPAIRED, 0, 7])


def test_what_is_unpaired_is_no_pairing() -> None:
    assert Hypothesis(FEATURES, 3.0, 6, Effort()).pairings == 3


def test_a_relocation_needs_enough_pairings_at_one_pose_only() -> None:
    found = Relocation(FEATURES, np.zeros(3), np.eye(3), 1.0, 3, 3, ambiguous=False, ties=0, effort=Effort())
    assert found.accepted
    assert not replace(found, min_pairings=4).accepted and not replace(found, ambiguous=True).accepted
