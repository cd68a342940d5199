"""The state of a training is plain text, and putting it back brings back the worlds and the random numbers."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from agents.evaluation.episodes import ExploreArguments
from agents.learning.many_worlds import WorldsForLearning
from agents.learning.ppo import load_hyperparameters, make_algorithm
from agents.learning.training_state import restore_state, state_of
from tests.rollouts import differences


def learner():
    worlds = ExploreArguments("office-small", split="train").make_many("twist", 2, workers=0)
    hyper = dataclasses.replace(load_hyperparameters("twist"), envs=2, steps=8, batch_size=16, epochs=1)
    return make_algorithm("twist", WorldsForLearning(worlds), hyper, 3)


def test_a_state_put_back_goes_on_alike() -> None:
    model = learner()
    model.learn(16)
    state = state_of(model)
    assert isinstance(json.loads(state), dict)
    first = model.env.step(np.full((2, 2), 0.5)), torch.rand(3), np.random.rand(3)  # noqa: NPY002
    other = learner()
    restore_state(other, state)
    assert not differences(other._last_episode_starts, model._last_episode_starts)
    assert other.env.lengths.tolist() == [8, 8]
    assert not differences(first, (other.env.step(np.full((2, 2), 0.5)), torch.rand(3), np.random.rand(3)))  # noqa: NPY002


@pytest.mark.parametrize("content", [b"{}", b"[1]", b"not text", b'{"worlds": [{"series": [], "wrong": 1}]}'])
def test_what_is_no_state_is_refused(content) -> None:
    with pytest.raises(ValueError):
        restore_state(learner(), content)
