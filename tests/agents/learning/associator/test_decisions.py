"""What a scan's decisions come to, against the marginals that the associator itself decides by."""

import dataclasses

import numpy as np
import pytest
import torch

from agents.learning.associator.decisions import Decisions, decisions_of, flat
from agents.learning.associator.training import TensorBatch, probabilities
from slam_gym.association.tracking.marginals import marginals
from slam_gym.simulation.right_answers import RightAnswers
from slam_gym.types import SPURIOUS, UNLABELLED, UNPAIRED, Truth
from tests.oracles import association as oracles


def answered(seed: int, heading: float = 0.0):
    """A problem, its truth, in which feature j of the map is j, and its decisions."""
    rng = np.random.default_rng(seed)
    scan, prediction = oracles.problem(rng, 6, 8, spread=2.0, heading_sigma=heading or 0.15)
    across = np.column_stack([prediction.positions[:, 1], -prediction.positions[:, 0]]) * heading**2
    prediction = dataclasses.replace(
        prediction, features=np.arange(8), heading_variance=heading**2, heading_covariances=across
    )
    near = [int(np.argmin(np.hypot(*(prediction.positions - point).T))) for point in scan.points]
    sources = np.where(rng.random(6) < 0.7, near, SPURIOUS)
    truth = RightAnswers.of(Truth(np.zeros(3), sources), np.arange(8))
    return scan, prediction, truth, decisions_of(scan, prediction, truth)


@pytest.mark.parametrize("seed", range(10))
def test_without_odds_the_probabilities_are_the_marginals(seed):
    scan, prediction, truth, found = answered(seed)
    batch = TensorBatch.of(flat([found]))
    p = probabilities(torch.zeros(len(found.inputs)), batch).numpy()
    whole = marginals(scan, prediction, width=150, margin=16.0)
    expected = [
        whole.unpaired[i] if truth.right[i] == UNPAIRED else whole.pairings[i, truth.right[i]]
        for i in np.flatnonzero(found.known)
    ]
    assert p == pytest.approx(np.array(expected), abs=1e-3)


def test_every_part_of_an_uncertain_heading_has_pairings_of_its_own():
    _, prediction, _, found = answered(2, heading=0.3)
    assert (found.slots >= len(prediction) + 1).any()
    own = [set(row[row >= 0].tolist()) for row in found.hypotheses]
    part = found.slots // (len(prediction) + 1)
    assert all(len({int(part[c]) for c in pairings}) <= 1 for pairings in own)


def test_what_nobody_knows_or_is_not_on_offer_teaches_nothing():
    scan, prediction, _, _ = answered(3)
    far = int(np.argmax(np.hypot(*(prediction.positions - scan.points[0]).T)))
    sources = np.array([far, UNLABELLED, SPURIOUS, SPURIOUS, SPURIOUS, SPURIOUS])
    truth = RightAnswers.of(Truth(np.zeros(3), sources), np.arange(8))
    found = decisions_of(scan, prediction, truth)
    assert found.known.tolist() == [False, False, True, True, True, True] and not found.right.any()
    nobody = RightAnswers.of(Truth(np.zeros(3), np.full(6, UNLABELLED)), np.arange(8))
    assert decisions_of(scan, prediction, nobody) is None


def test_scans_in_a_batch_do_not_mix():
    scans: list[Decisions] = [answered(seed)[3] for seed in (4, 5, 6)]
    together = TensorBatch.of(flat(scans))
    odds = torch.randn(len(together.inputs), generator=torch.Generator().manual_seed(0))
    whole, at, single = probabilities(odds, together).numpy(), 0, []
    for d in scans:
        single.append(probabilities(odds[at : at + len(d.inputs)], TensorBatch.of(flat([d]))).numpy())
        at += len(d.inputs)
    assert whole == pytest.approx(np.concatenate(single), abs=1e-6)
