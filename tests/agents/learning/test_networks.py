"""The scoring policies: one network for every choice, whatever their number and order."""

import numpy as np
import torch
from gymnasium import spaces

from agents.learning.model_file import build_policy
from agents.learning.networks import BranchPolicy
from slam_gym.association.tracking.observation import lengths
from tests.agents.learning import FIELDS, drawn, opinionated, scores, spec_of


def test_permuted_goals_get_permuted_scores():
    rng, policy = np.random.default_rng(1), opinionated()
    observation, _ = drawn(spec_of("goal"), rng)
    order = rng.permutation(16)
    permuted = observation | {"goals": observation["goals"].reshape(16, FIELDS)[order].ravel()}
    before, after = scores(policy, observation), scores(policy, permuted)
    assert np.ptp(before) > 0.1
    np.testing.assert_allclose(after, before[order], atol=1e-5)


def test_the_same_weights_serve_another_number_of_goals():
    policy = opinionated()
    wider = build_policy(spec_of("goal", slots=40))
    wider.load_state_dict(policy.state_dict())
    observation, _ = drawn(spec_of("goal", slots=40), np.random.default_rng(2), slots=40)
    assert scores(wider, observation).shape == (40,)
    # Goals that are not legal count for nothing, so the wider network agrees on the slots that both have.
    goals = observation["goals"].reshape(40, FIELDS)
    goals[16:] = 0.0
    cut = observation | {"goals": goals[:16].ravel()}
    np.testing.assert_allclose(scores(wider, observation)[:16], scores(policy, cut), atol=1e-5)


def test_the_fresh_policy_is_close_to_uniform():
    torch.manual_seed(0)
    observation, _ = drawn(spec_of("goal"), np.random.default_rng(3))
    assert np.abs(scores(build_policy(spec_of("goal")), observation)).max() < 0.1


def network(candidates):
    space = {name: spaces.Box(-1.0, 1.0, (length,), np.float32) for name, length in lengths(candidates).items()}
    space["budget"] = spaces.Box(0.0, 1.0, (1,), np.float32)
    torch.manual_seed(0)
    return BranchPolicy(spaces.Dict(space), spaces.Discrete(candidates + 1), lambda _: 1e-3, width=16, hidden=16)


def branches(candidates, rng):
    out = {
        name: torch.as_tensor(rng.uniform(-1, 1, (2, n)), dtype=torch.float32)
        for name, n in lengths(candidates).items()
    }
    rows = out["candidates"].reshape(2, candidates, -1)
    rows[:, :, 0] = 1.0
    return out | {"budget": torch.ones(2, 1)}


def test_permuted_candidates_have_permuted_scores_and_the_refusal_keeps_its_own():
    rng, policy, order = np.random.default_rng(0), network(4), [2, 0, 3, 1]
    seen = branches(4, rng)
    permuted = seen | {"candidates": seen["candidates"].reshape(2, 4, -1)[:, order].reshape(2, -1)}
    with torch.no_grad():
        before, after = policy.scores(seen), policy.scores(permuted)
    assert before.shape == (2, 5)
    torch.testing.assert_close(before[:, [*order, 4]], after)
    assert not torch.allclose(before[:, 0], before[:, 1])


def test_weights_fit_any_number_of_candidates_and_ignore_the_budget():
    few, many = network(2), network(7)
    many.load_state_dict(few.state_dict())
    seen = branches(7, np.random.default_rng(1))
    with torch.no_grad():
        found = many.scores(seen)
        torch.testing.assert_close(found, many.scores(seen | {"budget": torch.zeros(2, 1)}))
    assert found.shape == (2, 8)
