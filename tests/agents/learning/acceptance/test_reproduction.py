"""The plan of the training that ships, and the figures of its card."""

import numpy as np

from agents.learning.acceptance.answers import Answer, Asked
from agents.learning.acceptance.reproduction import Plan, sources, trained
from slam_gym.association.learned.acceptance import INPUTS


def test_every_level_is_asked_in_every_world():
    found = sources(Plan())
    assert len(set(found)) == len(found) == 12 * 5 + 4 * 4


def test_figures_are_those_of_worlds_held_out():
    rng, found = np.random.default_rng(0), {}
    for world in range(24):
        answers = []
        for inside in (True, True, False):
            x = rng.normal(size=len(INPUTS))
            x[0] = 4.0 if inside else -4.0
            answers.append(Answer(x, inside, inside, True))
        found["kidnapped/0", world] = Asked(answers, 2, 1)
    said: list[str] = []
    weights = trained(Plan(), found, "python -m agents.reproduce acceptance", said.append)
    metrics = weights.card.metrics
    assert metrics["invented"]["estimate"] == 0.0 and metrics["inside, right"]["estimate"] > 0.9
    assert metrics["invented, by the rule"]["estimate"] == 1.0 and len(said) == 2
    assert metrics["invented"]["high"] > 0.0 and weights.arrays["linear"][0] > 0.0
