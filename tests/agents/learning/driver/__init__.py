"""Models and observations made by hand, for the tests of networks and policies."""

import numpy as np
import torch

from agents.learning.model_file import ModelSpec, build_policy
from agents.learning.ppo import load_hyperparameters
from slam_gym.envs.goal_observation import GOAL_FIELDS

FIELDS = len(GOAL_FIELDS)


def spec_of(action, slots=16):
    observation = {"scan": [30], "uncertainty": [3], "budget": [1], "image": [3, 48, 48]}
    if action == "goal":
        observation["goals"] = [slots * FIELDS]
    hyper = load_hyperparameters(action)
    return ModelSpec(action, observation, slots if action == "goal" else 2, vars(hyper).copy(), {"seed": 0})


def drawn(spec, rng, slots=16):
    """An observation of random numbers, and the legal goals in it."""
    observation = {
        key: rng.integers(0, 256, shape).astype(np.uint8) if key == "image" else rng.random(shape, dtype=np.float32)
        for key, shape in spec.observation.items()
    }
    legal = np.ones(slots, bool)
    if spec.action == "goal":
        goals = rng.random((slots, FIELDS), dtype=np.float32)
        legal[1:] = rng.random(slots - 1) < 0.5
        goals[:, GOAL_FIELDS.index("legal")] = legal
        goals[~legal] = 0.0
        observation["goals"] = goals.ravel()
    return observation, {"action_mask": legal}


def scores(policy, observation):
    with torch.no_grad():
        return policy.scores({key: torch.as_tensor(value)[None] for key, value in observation.items()})[0].numpy()


def opinionated():
    """A fresh goal policy whose scores differ: fresh ones are all close to zero."""
    torch.manual_seed(0)
    built = build_policy(spec_of("goal"))
    with torch.no_grad():
        built.mlp_extractor.score[-1].weight.mul_(300.0)
    return built
