"""Random sampling against all that any sample leads to; its tries and its seed."""

from dataclasses import replace

import pytest

from slam_gym.association import random_sampling
from slam_gym.association.relocation.random_sampling import tries
from tests.oracles import relocation as oracles

LOCALITIES = ["everything", "distance", "covisibility"]


@pytest.mark.parametrize("locality", LOCALITIES)
@pytest.mark.parametrize("seed", range(12))
def test_random_sampling_with_every_sample_finds_the_best_that_a_sample_leads_to(seed, locality):
    scan, landmarks, P, localities = oracles.small_problem(seed + 500, largest=4)
    found = random_sampling(scan, landmarks, localities[locality], p_fail=1e-12, p_good=0.5)
    oracles.check_against(
        found, oracles.random_sampling(scan, landmarks, P, localities[locality], 0.99), scan, landmarks, P
    )


def test_same_seed_same_answer():
    _, scan, landmarks = oracles.inside(4)
    first, second = (random_sampling(scan, landmarks, seed=5) for _ in range(2))
    assert first.features.tolist() == second.features.tolist()
    assert replace(first.effort, seconds=0.0) == replace(second.effort, seconds=0.0)


def test_tries_are_those_of_the_formula():
    """The figures of the source: P_fail .05, p = 3."""
    found = [tries(0.05, p_good, 3) for p_good in (0.9, 0.8, 0.7, 0.6, 0.5, 0.3)]
    assert found == [3, 5, 8, 13, 23, 110] and tries(0.05, 1.0, 3) == 1
    _, scan, landmarks = oracles.inside(4)
    assert random_sampling(scan, landmarks, p_good=0.5).effort.tries == 23
    with pytest.raises(ValueError, match="p_fail"):
        random_sampling(scan, landmarks, p_fail=0.0)
