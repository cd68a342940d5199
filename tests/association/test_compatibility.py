"""Gates, individual and joint compatibility against their definitions."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import chi2

from slam_gym.association.compatibility import chi2_gate, individual, joint_gates
from tests.oracles import association as oracles
from tests.oracles.statistics import for_seeds


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.99, 0.999])
def test_gates_are_quantiles_of_chi_square(confidence):
    assert [chi2_gate(d, confidence) for d in range(1, 61)] == pytest.approx(chi2.ppf(confidence, np.arange(1, 61)))
    assert joint_gates(20, confidence)[1:] == pytest.approx(chi2.ppf(confidence, np.arange(2, 41, 2)))


@pytest.mark.parametrize(("dof", "confidence"), [(0, 0.99), (2, 0.0), (2, 1.0), (2, math.nan)])
def test_meaningless_gates_are_refused(dof, confidence):
    with pytest.raises(ValueError, match=r"dof|confidence"):
        chi2_gate(dof, confidence)


@for_seeds(100)
def test_candidates_are_the_individually_compatible_pairings_of_chosen_measurements(seed):
    rng = np.random.default_rng(seed)
    m, n, noise = int(rng.integers(0, 25)), int(rng.integers(0, 40)), float(rng.choice([0.05, 0.5]))
    scan, prediction = oracles.problem(rng, m, n, spread=2.0, noise=noise)
    confidence = [0.5, 0.95, 0.99][seed % 3]
    chosen = rng.permutation(m)[: rng.integers(m + 1)] if seed % 4 == 0 else np.arange(m)
    candidates = individual(scan, prediction, confidence, measurements=chosen if seed % 4 == 0 else None)
    expected = oracles.compatible(scan, prediction, confidence)
    rows = candidates.rows[candidates.slots]
    for level, i in enumerate(chosen):
        here = slice(*candidates.starts[level : level + 2])
        assert rows[here].tolist() == [j for _, j in expected[i]]
        assert candidates.distances[here] == pytest.approx([d2 for d2, _ in expected[i]])
        assert candidates.innovations[here] == pytest.approx(scan.points[i] - prediction.positions[rows[here]])
        assert (candidates.measured[here] == i).all()
    assert candidates.rows.tolist() == sorted(set(rows.tolist()))


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("what", ["positions", "covariances"])
def test_a_prediction_that_is_not_finite_is_refused_by_name(what, value):
    scan, prediction = oracles.problem(np.random.default_rng(0), 4, 5)
    spoilt = getattr(prediction, what).copy()
    spoilt[2, 0] = value
    known = prediction.expected._replace(**{what: spoilt})
    with pytest.raises(ValueError, match=rf"prediction.{what}\[2\]"):
        individual(scan, dataclasses.replace(prediction, expected=known))
