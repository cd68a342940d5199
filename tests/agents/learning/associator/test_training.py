"""The network that is trained is the one that ships, and training makes what is right more probable."""

import numpy as np
import torch

from agents.learning.associator.decisions import flat
from agents.learning.associator.training import Odds, TensorBatch, Training, fit, loss_of, mean_loss, scale_of
from slam_gym.association.learned.network import log_odds, network_of
from tests.agents.learning.associator.test_decisions import answered


def test_the_network_is_that_of_the_package():
    scans = [answered(seed)[3] for seed in range(4)]
    torch.manual_seed(0)
    network = Odds(*scale_of(scans), hidden=6)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter)
    batch = flat(scans)
    assert network(TensorBatch.of(batch)).abs().max() <= 16.0  # in training
    expected = network.eval()(TensorBatch.of(batch)).detach().numpy()
    assert np.abs(expected).max() > 16.0
    arrays = network.arrays()
    found = log_odds(network_of(arrays), batch.inputs.astype(np.float64), batch.measured, batch.slots)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-3)
    assert torch.equal(Odds.of(network_of(arrays))(TensorBatch.of(batch)), network(TensorBatch.of(batch)))


def test_training_starts_at_the_model_and_gets_better():
    scans = [answered(seed)[3] for seed in range(30)]
    untrained = Odds(*scale_of(scans), hidden=4)
    batch = TensorBatch.of(flat(scans))
    assert torch.equal(untrained(batch), torch.zeros(len(batch.inputs)))
    network, losses = fit(scans, scans[:10], Training(hidden=4, epochs=20, batch=10))
    assert losses.train < loss_of(torch.zeros(len(batch.inputs)), batch) - 0.02
    assert len(losses.curve) == 20 and losses.held_out < losses.curve[0] < losses.model
    assert losses.held_out == mean_loss(network, [TensorBatch.of(flat(scans[:10]))])


def test_one_seed_is_one_training():
    scans = [answered(seed)[3] for seed in range(6)]
    first, again, other = (fit(scans, [], Training(hidden=3, epochs=2, batch=3, seed=s))[0].arrays() for s in (1, 1, 2))
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert not np.array_equal(first["first"], other["first"])
