"""The training of the learned associator: where its scans come from, what in them is right, and what is learned."""

import dataclasses

import numpy as np
import pytest
import torch

from agents.learning import associator
from slam_gym.association.tracking.marginal import examples, weigh
from slam_gym.association.tracking.network import INPUTS, log_odds, network_of
from slam_gym.scenarios import get_scenario
from slam_gym.simulation.judged import RightAnswers
from slam_gym.types import SPURIOUS, UNLABELLED, UNPAIRED, Truth
from tests.oracles import association as oracles


def answered(seed: int, heading: float = 0.0):
    """A problem, its truth, in which feature j of the map is j, and its decisions."""
    rng = np.random.default_rng(seed)
    scan, prediction = oracles.problem(rng, 6, 8, spread=2.0, heading_sigma=heading or 0.15)
    across = np.column_stack([prediction.positions[:, 1], -prediction.positions[:, 0]]) * heading**2
    prediction = oracles.expecting(
        prediction.positions, prediction.joint(np.arange(8)), heading_variance=heading**2, across=across
    )
    near = [int(np.argmin(np.hypot(*(prediction.positions - point).T))) for point in scan.points]
    sources = np.where(rng.random(6) < 0.7, near, SPURIOUS)
    truth = RightAnswers.of(Truth(np.zeros(3), sources), np.arange(8))
    return scan, prediction, truth, associator.decisions_of(scan, prediction, truth)


# -- what is right -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(10))
def test_without_odds_the_probabilities_are_the_marginals(seed):
    scan, prediction, truth, found = answered(seed)
    p = associator.probabilities(torch.zeros(len(found.inputs)), associator.Batch.of([found])).numpy()[0, found.known]
    whole = weigh(scan, prediction, width=150, margin=16.0)[1]
    expected = [
        whole.unpaired[i] if truth.right[i] == UNPAIRED else whole.pairings[i, truth.right[i]]
        for i in np.flatnonzero(found.known)
    ]
    assert p == pytest.approx(np.array(expected), abs=1e-3)


def test_scans_of_one_batch_do_not_touch_each_other():
    scans = [answered(seed)[3] for seed in range(5)]
    together = associator.probabilities(torch.zeros(sum(len(d.inputs) for d in scans)), associator.Batch.of(scans))
    for row, d in zip(together, scans):
        alone = associator.probabilities(torch.zeros(len(d.inputs)), associator.Batch.of([d]))[0]
        torch.testing.assert_close(row[: len(alone)], alone)


def test_what_nobody_knows_or_is_not_on_offer_teaches_nothing():
    scan, prediction, _, _ = answered(3)
    far = int(np.argmax(np.hypot(*(prediction.positions - scan.points[0]).T)))
    sources = np.array([far, UNLABELLED, SPURIOUS, SPURIOUS, SPURIOUS, SPURIOUS])
    truth = RightAnswers.of(Truth(np.zeros(3), sources), np.arange(8))
    found = associator.decisions_of(scan, prediction, truth)
    assert found.known.tolist() == [False, False, True, True, True, True]
    assert not found.agreed[found.hypotheses != UNPAIRED].any()
    elsewhere = dataclasses.replace(scan, points=scan.points + 1e3)  # compatible with nothing: nothing to learn
    assert associator.decisions_of(elsewhere, prediction, truth) is None
    nobody = RightAnswers.of(Truth(np.zeros(3), np.full(6, UNLABELLED)), np.arange(8))
    assert associator.decisions_of(scan, prediction, nobody) is None


def test_of_the_copies_of_a_feature_only_the_oldest_is_right():
    scan, prediction, _, found = answered(1)
    offered = [np.unique(found.slots[found.hypotheses[:, i]][found.hypotheses[:, i] != UNPAIRED]) for i in range(6)]
    i = next(i for i in range(6) if len(offered[i]) > 1)
    oldest, copy = offered[i][:2]
    identities, sources = np.arange(8), np.full(6, UNLABELLED)
    identities[copy], sources[i] = oldest, oldest
    again = associator.decisions_of(scan, prediction, RightAnswers.of(Truth(np.zeros(3), sources), identities))
    paired = np.append(again.slots, UNPAIRED)[again.hypotheses[:, i]]
    assert {oldest, copy} <= set(paired)
    assert again.agreed[:, i].tolist() == (paired == oldest).tolist()


# -- where scans come from ---------------------------------------------------------------------------------------------


def test_no_world_is_both_trained_on_and_held_out():
    train, held_out = associator.sources(associator.AssociatorPlan())
    assert len(set(train)) == len(train)
    assert not {s.world for s in train} & {s.world for s in held_out}
    assert {s.hidden for s in held_out} == {(), *associator.HIDDEN}
    assert {s.hidden for s in train} == {(), *associator.HIDDEN, ("views",), ("views", "past")}
    assert {s.kind for s in train} == set(associator.SHARES) and {s.kind for s in held_out} == {"level"}
    assert len(associator.AssociatorPlan().levels) == 35 and all(
        get_scenario(s.name).name == s.name for s in train if s.kind == "drive"
    )


def test_a_level_gives_scans_of_train_worlds_with_kinds_where_they_are_told():
    plain = list(associator.Source("level", "closure/2", 0).scans(count=3))
    kinds = list(associator.Source("level", "closure/2", 0, hidden=("sizes", "kinds told")).scans(count=3))
    assert len(plain) == len(kinds) == 3
    same, known = INPUTS.index("kind: the same"), INPUTS.index("size: whether both are known")
    assert plain[0].inputs[:, known].all() and not plain[0].inputs[:, same].any()
    assert kinds[0].inputs[:, same].any() and not kinds[0].inputs[:, known].any()


# -- what is learned ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("heading", [0.0, 0.4])
def test_the_network_is_that_of_the_package_where_headings_are_searched_one_by_one(heading):
    answers = [answered(seed, heading) for seed in range(4)]
    parts = [
        part for scan, prediction, *_ in answers
        for part in examples(scan, prediction, width=associator.WIDTH, margin=associator.MARGIN)
    ]  # fmt: skip
    assert (len(parts) > len(answers)) == (heading > 0.0)
    scans = [decisions for *_, decisions in answers]
    network, batch = associator.untrained(scans, hidden=6), associator.Batch.of(scans)
    rng = np.random.default_rng(0)
    network = network._replace(**{name: rng.normal(size=part.shape) for name, part in network._asdict().items()
                                  if name not in ("centre", "scale")})  # fmt: skip
    expected = associator.odds_of(associator.tensors(network), batch).numpy()
    limited = associator.odds_of(associator.tensors(network), batch, most=16.0).numpy()
    assert np.abs(expected).max() > 16.0 >= np.abs(limited).max()
    shipped = network_of(network._asdict())
    given = [part.inputs.astype(np.float32).astype(np.float64) for part in parts]  # the rounding of tensors
    found = [log_odds(shipped, inputs, part.measured, part.rows) for inputs, part in zip(given, parts)]
    np.testing.assert_allclose(np.concatenate(found), expected, rtol=1e-4, atol=1e-3)


def test_training_starts_at_the_model_gets_better_and_is_the_same_for_one_seed():
    scans = [answered(seed)[3] for seed in range(30)]
    held_out, model, batch = scans[:10], associator.tensors(associator.untrained(scans, 4)), associator.Batch.of(scans)
    assert torch.equal(associator.odds_of(model, batch), torch.zeros(len(batch.inputs)))
    plan = associator.AssociatorPlan(hidden_numbers=4, epochs=60)
    network, curve = associator.trained(plan, scans, held_out, seed=0)
    assert associator.mean_loss(network, scans) < associator.mean_loss(model, scans) - 0.02
    assert associator.mean_loss(network, held_out) == curve[-1] < curve[0] <= associator.mean_loss(model, held_out)
    again, other = (associator.trained(plan, scans, held_out, seed=seed)[0] for seed in (0, 1))
    assert all(map(torch.equal, network, again)) and not torch.equal(again.first, other.first)
