"""Answers of the search in train worlds, inside the map and from another building."""

import numpy as np

from agents.learning.acceptance.answers import asked
from slam_gym.association.learned.acceptance import INPUTS


def test_most_answers_inside_are_right_and_none_from_outside_is():
    found = asked("kidnapped/0", 0, 8)
    assert (found.inside, found.outside) == (4, 4)
    inside, outside = ([a for a in found.answers if a.inside == where] for where in (True, False))
    assert sum(a.right for a in inside) >= 3 and not any(a.right for a in outside)
    assert all(a.inputs.shape == (len(INPUTS),) and np.isfinite(a.inputs).all() for a in found.answers)
    assert all(a.by_rule == (a.inputs[INPUTS.index("pairings beyond the rule")] >= 0) for a in found.answers)
