"""Random sampling against all that any sample leads to; the number of samples and their seed."""

from dataclasses import replace

import pytest

from slam_gym.association import random_sampling
from tests.oracles import relocation as oracles
from tests.oracles.statistics import for_seeds

LOCALITIES = ["everything", "distance", "covisibility"]


@pytest.mark.parametrize("locality", LOCALITIES)
@for_seeds(12)
def test_random_sampling_with_every_sample_finds_the_best_that_a_sample_leads_to(seed, locality):
    scan, landmarks, P, localities = oracles.small_problem(seed + 500, largest=4)
    found = random_sampling(scan, landmarks, localities[locality], tries=207)
    oracles.check_against(
        found, oracles.random_sampling(scan, landmarks, P, localities[locality], 0.99), scan, landmarks, P
    )


def test_same_seed_same_answer():
    _, scan, landmarks = oracles.inside(4)
    first, second = (random_sampling(scan, landmarks, seed=5) for _ in range(2))
    assert first.features.tolist() == second.features.tolist()
    assert replace(first.effort, seconds=0.0) == replace(second.effort, seconds=0.0)


def test_as_many_samples_as_asked_for():
    _, scan, landmarks = oracles.inside(4)
    assert (
        random_sampling(scan, landmarks).effort.tries == 8
        and random_sampling(scan, landmarks, tries=23).effort.tries == 23
    )
    with pytest.raises(ValueError, match="tries 0"):
        random_sampling(scan, landmarks, tries=0)
