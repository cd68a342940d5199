"""Beams of different width (wide ones against every hypothesis: `test_map_hypothesis`)."""

import numpy as np
import pytest

from slam_gym.association import map_hypothesis
from tests.oracles import association as oracles


@pytest.mark.parametrize("seed", range(30))
def test_a_beam_of_the_default_width_loses_nothing_on_larger_problems(seed):
    scan, prediction = oracles.problem(np.random.default_rng(seed), 9, 12, spread=2.5)
    answer = map_hypothesis(scan, prediction)
    wide = map_hypothesis(scan, prediction, width=4000, margin=1e9)
    assert answer.features.tolist() == wide.features.tolist()
    assert answer.posterior.probability == pytest.approx(wide.posterior.probability, abs=0.05)


@pytest.mark.parametrize("seed", range(10))
def test_a_narrow_beam_says_so(seed):
    scan, prediction = oracles.problem(np.random.default_rng(seed), 9, 12, spread=2.0)
    narrow = map_hypothesis(scan, prediction, width=1)
    assert narrow.effort.limit_hit
    assert narrow.posterior.probability == 1.0 and narrow.posterior.runner_up_probability == 0.0
    wide = map_hypothesis(scan, prediction)
    assert wide.posterior.log_density >= narrow.posterior.log_density
    assert wide.effort.nodes > narrow.effort.nodes
