"""The goal policy: one network for every goal, whatever their number and order."""

import numpy as np
import pytest
import torch
from gymnasium import spaces

from agents.drivers.base import make_agent
from agents.learning.ppo import ModelSpec, PolicyAgent, build_policy, load_hyperparameters, read_model, save_model
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
        return policy.goal_scores({key: torch.as_tensor(value)[None] for key, value in observation.items()})[0].numpy()


@pytest.fixture(scope="module")
def policy():
    torch.manual_seed(0)
    built = build_policy(spec_of("goal"))
    with torch.no_grad():  # fresh scores are all close to zero: make them differ
        built.mlp_extractor.score[-1].weight.mul_(300.0)
    return built


def test_permuted_goals_get_permuted_scores(policy):
    rng = np.random.default_rng(1)
    observation, _ = drawn(spec_of("goal"), rng)
    order = rng.permutation(16)
    permuted = observation | {"goals": observation["goals"].reshape(16, FIELDS)[order].ravel()}
    before, after = scores(policy, observation), scores(policy, permuted)
    assert np.ptp(before) > 0.1
    np.testing.assert_allclose(after, before[order], atol=1e-5)


def test_the_same_weights_serve_another_number_of_goals(policy):
    wider = build_policy(spec_of("goal", slots=40))
    wider.load_state_dict(policy.state_dict())
    observation, info = drawn(spec_of("goal", slots=40), np.random.default_rng(2), slots=40)
    assert scores(wider, observation).shape == (40,)
    # Goals that are not legal count for nothing, so the wider network agrees on the slots that both have.
    goals = observation["goals"].reshape(40, FIELDS)
    goals[16:] = 0.0
    cut = observation | {"goals": goals[:16].ravel()}
    np.testing.assert_allclose(scores(wider, observation)[:16], scores(policy, cut), atol=1e-5)
    assert PolicyAgent(policy, "goal", deterministic=True).act(observation, info) in np.flatnonzero(info["action_mask"])


def test_the_fresh_policy_is_close_to_uniform():
    torch.manual_seed(0)
    observation, _ = drawn(spec_of("goal"), np.random.default_rng(3))
    assert np.abs(scores(build_policy(spec_of("goal")), observation)).max() < 0.1


@pytest.mark.parametrize("deterministic", [True, False])
def test_only_legal_goals_are_driven_to(policy, deterministic):
    agent, rng = PolicyAgent(policy, "goal", deterministic=deterministic), np.random.default_rng(4)
    for _ in range(50):
        observation, info = drawn(spec_of("goal"), rng)
        assert info["action_mask"][agent.act(observation, info)]


def test_drawn_goals_follow_the_scores_and_the_seed(policy):
    agent = PolicyAgent(policy, "goal", deterministic=False)
    observation, info = drawn(spec_of("goal"), np.random.default_rng(5))
    expected = np.where(info["action_mask"], np.exp(scores(policy, observation)), 0.0)
    expected /= expected.sum()
    runs = []
    for _ in range(2):
        agent.reset(9)
        runs.append([agent.act(observation, info) for _ in range(600)])
    assert runs[0] == runs[1]
    shares = np.bincount(runs[0], minlength=16) / 600
    assert np.abs(shares - expected).max() < 4 * np.sqrt(0.25 / 600)


@pytest.mark.parametrize("action", ["goal", "twist"])
def test_a_model_file_gives_back_the_same_driver(tmp_path, action):
    spec = spec_of(action)
    torch.manual_seed(1)
    policy = build_policy(spec)
    save_model(tmp_path / "model.pt", spec, policy)
    agent, rng = make_agent("ppo", tmp_path / "model.pt"), np.random.default_rng(6)
    original = PolicyAgent(policy, action, deterministic=bool(spec.hyperparameters["deterministic"]))
    assert agent.action == action
    assert read_model(tmp_path / "model.pt")[0] == spec
    for _ in range(5):
        observation, info = drawn(spec, rng)
        chosen = agent.act(observation, info)
        np.testing.assert_array_equal(chosen, original.act(observation, info))
        if action == "twist":
            assert spaces.Box(-1.0, 1.0, (2,), np.float32).contains(chosen)
