"""What hypotheses have in view (what they are weighed by: `test_map_hypothesis`, `test_marginal`)."""

import dataclasses
import math

import numpy as np
import pytest

from slam_gym.association.compatibility import chi2_gate, individual
from slam_gym.association.tracking.scan_hypotheses import Rates, search, views
from slam_gym.association.tree import interpretation_tree
from slam_gym.types import UNPAIRED
from tests.oracles import association as oracles
from tests.oracles import densities


def kept(seed, view):
    scan, prediction = oracles.problem(np.random.default_rng(seed), 4, 6, spread=1.5)
    prediction = dataclasses.replace(prediction, view=view)
    tree = interpretation_tree(scan, prediction, individual(scan, prediction, 0.999))
    visibility = prediction.visibility()
    return search(tree, visibility, Rates(0.9, 0.05, 0.02), chi2_gate(2, 0.999), 1000, 1e9), visibility


@pytest.mark.parametrize("seed", range(20))
def test_every_hypothesis_has_its_own_fit_and_view(seed):
    found, visibility = kept(seed, densities.edge)
    scan, prediction = found.tree.scan, found.tree.prediction
    seen = views(found, visibility)
    assert sorted(seen.group) == list(range(len(found.fit)))
    for b in range(len(found.fit)):
        rows = found.rows[b]
        pairs = [(i, int(j)) for i, j in enumerate(rows) if j != UNPAIRED]
        assert found.unpaired[b] == 4 - len(pairs)
        assert found.fit[b] == pytest.approx(densities.fit(scan, prediction, pairs), abs=1e-9)
        expected = densities.visibilities(scan, prediction, pairs)
        assert seen.visibility[seen.group[b], seen.columns] == pytest.approx(expected[found.tree.rows], abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_hypotheses_that_move_features_little_apart_share_a_view(seed):
    calls = []

    def view(positions, covariances):
        calls.append(positions.copy())
        return densities.edge(positions, covariances)

    found, visibility = kept(seed, view)
    exact, shared = views(found, visibility), views(found, visibility, 0.3)
    apart = calls[-1].reshape(len(shared.visibility), -1, 2)
    assert len(shared.visibility) <= len(exact.visibility) and set(shared.group) == set(range(len(apart)))
    for a in range(len(apart)):
        for b in range(a):
            assert np.hypot(*(apart[a] - apart[b]).T).max() >= 0.3
    # within 30 cm the edge changes by no more than this
    difference = np.abs(shared.visibility[shared.group] - exact.visibility[exact.group])
    assert difference.max(initial=0.0) < 3.0 * 0.3 / 4.0 + 0.1


def test_where_all_is_known_well_there_is_one_view_that_nobody_is_asked_for_again():
    found, visibility = kept(1, densities.everywhere)
    sigma = math.sqrt(found.tree.prediction.covariances[:, (0, 1), (0, 1)].max())
    assert len(views(found, visibility, 1.01 * sigma).visibility) == 1
    still = found.tree._replace(prediction=dataclasses.replace(found.tree.prediction, view_moves=False))
    assert views(found._replace(tree=still), visibility).visibility.shape == (1, 6)
    assert views(found, None).visibility.shape == (0, 0)
