"""The network that learns and the one that ships are the same."""

import numpy as np
import torch

from agents.drivers.goal_network import Size, gaps_between, greedy_score, scores, shapes
from agents.learning.driver.network import GoalNetwork
from agents.learning.driver.reproduction import stacked
from tests.agents.drivers.test_goal_network import some_tokens

SIZE = Size(width=8, heads=2, layers=2, members=2)


def networks():
    torch.manual_seed(0)
    found = [GoalNetwork(SIZE) for _ in range(SIZE.members)]
    for network in found:
        for parameter in network.parameters():
            torch.nn.init.normal_(parameter, 0.0, 0.3)
    return found


def of_torch(network, tokens, legal):
    parts = (tokens.fields, gaps_between(tokens.places), greedy_score(tokens.rates))
    with torch.no_grad():
        found = network(
            *(torch.as_tensor(part, dtype=torch.float32)[None] for part in parts), torch.as_tensor(legal)[None]
        )
    return found[0].numpy()


def test_plain_arrays_give_the_scores_that_torch_gives():
    tokens, legal = some_tokens()
    members = networks()
    arrays = stacked(members)
    assert {name: array.shape for name, array in arrays.items()} == shapes(SIZE)
    expected = np.mean([of_torch(network, tokens, legal) for network in members], axis=0)
    assert np.allclose(scores(arrays, SIZE, tokens, legal)[legal], expected[legal], atol=1e-4)


def test_an_untrained_network_orders_goals_as_the_greedy_driver():
    tokens, legal = some_tokens()
    found = of_torch(GoalNetwork(SIZE), tokens, legal)
    assert np.allclose(found[legal], 3.0 * greedy_score(tokens.rates)[legal], atol=1e-5)
