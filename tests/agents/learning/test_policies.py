"""Learned drivers and associators decide legally, repeatably, and as their model file says."""

import pickle

import numpy as np
import pytest
import torch
from gymnasium import spaces

from agents.drivers.base import make_agent
from agents.evaluation.episodes import AssociateArguments, associate_episode
from agents.learning.model_file import ModelSpec, build_policy, read_model, save_model
from agents.learning.policies import BestBranch, PolicyAgent, load_associator
from agents.learning.ppo import load_hyperparameters
from slam_gym.association.tracking.observation import lengths
from slam_gym.simulation.association_runs import CORRIDOR
from slam_gym.slam.slam import Slam
from tests.agents.learning import drawn, opinionated, scores, spec_of


@pytest.fixture(scope="module")
def policy():
    return opinionated()


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


# -- associators ---------------------------------------------------------------------------------------------------

ARGUMENTS = AssociateArguments("corridor", candidates=3, order="fewest_candidates")


@pytest.fixture(scope="module")
def branch_model(tmp_path_factory):
    """The file of an associator that has not learned anything, but has opinions."""
    torch.manual_seed(0)
    path, hyper = tmp_path_factory.mktemp("branch") / "model.pt", load_hyperparameters("branch")
    observation = {name: [n] for name, n in (lengths(3) | {"budget": 1}).items()}
    spec = ModelSpec("branch", observation, 4, vars(hyper).copy(), ARGUMENTS.plain)
    policy = build_policy(spec)
    with torch.no_grad():
        policy.mlp_extractor.score[-1].weight.mul_(300.0)
    save_model(path, spec, policy)
    return path


def test_a_model_is_an_associator_that_decides_as_in_the_environment(branch_model):
    associate = load_associator(branch_model)
    env = ARGUMENTS.make().unwrapped
    observation, info = env.reset(seed=0)
    over, look = False, 0
    while not over:
        if env.walk is not None and info["look"] != look:
            look, expected = info["look"], associate(env.run.scan, env.run.prediction)
        action = associate.policy(observation, info["action_mask"])
        assert env.walk is None or action == env.action_of(expected)
        observation, _, over, _, info = env.step(action)
    again, slam = pickle.loads(pickle.dumps(associate)), Slam(CORRIDOR.slam)
    for odometry, scan, _ in CORRIDOR.scans(np.random.default_rng(0)):
        slam.step(odometry, scan, again)
    assert slam.map.n > 50


def test_episodes_of_a_policy_are_reproduced(branch_model):
    associate = load_associator(branch_model)
    env = ARGUMENTS.make()
    one, other = (associate_episode(env, associate.policy, 4) for _ in range(2))
    assert one == other
    assert one["decisions"] > 100
    assert isinstance(associate.policy, BestBranch)


def test_a_driver_is_no_associator_and_an_associator_no_driver(branch_model, tmp_path):
    with pytest.raises(ValueError, match="not a driver"):
        make_agent("ppo", branch_model)
    with pytest.raises(ValueError, match="no such file"):
        load_associator(tmp_path / "none.pt")
    spec = spec_of("goal")
    save_model(tmp_path / "driver.pt", spec, build_policy(spec))
    with pytest.raises(ValueError, match="not an associator"):
        load_associator(tmp_path / "driver.pt")
