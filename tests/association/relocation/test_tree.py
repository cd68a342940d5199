"""The tree without a prior: legality, look-ahead and bound by brute force."""

import numpy as np
import pytest

from slam_gym.association.relocation.walk import RelocationWalk
from slam_gym.types import UNPAIRED
from tests.oracles import relocation as oracles
from tests.oracles import relocation_walks as walks
from tests.oracles.geometry import differences
from tests.oracles.relocation_walks import ALL, LOCALITIES
from tests.oracles.statistics import for_seeds


@pytest.mark.parametrize("locality", LOCALITIES)
@for_seeds(20)
def test_on_offer_is_what_agrees_with_the_path_and_passed_by_is_what_nothing_agrees_with(seed, locality):
    scan, landmarks, P, localities, rng = walks.plant(seed)
    related, n = oracles.relation(localities[locality], len(landmarks)), len(landmarks)
    walk = RelocationWalk(ALL, scan, landmarks, localities[locality])

    def legal(path, i):
        return {j for j in range(n) if oracles.legal(scan, landmarks, P, related, path, (i, j), 0.99)}

    for _ in walks.walk_randomly(walk, rng):
        assert set(walk.offer.features.tolist()) == legal(walks.pairs_of(walk), walk.measurement)
        assert walk.mask[: len(walk.offer.features)].all() and not walk.mask[len(walk.offer.features) : -2].any()
    path = []
    for i, (j, (shown, action)) in enumerate(zip(walk.node.hypothesis, walk.offered, strict=True)):
        assert shown == len(legal(path, i))
        assert (action == ALL.star) == (j == UNPAIRED)
        path += [(i, j)] if j != UNPAIRED else []


@pytest.mark.parametrize("locality", LOCALITIES)
@for_seeds(20)
def test_support_counts_the_measurements_that_keep_a_legal_partner_and_ranks_the_offer(seed, locality):
    scan, landmarks, P, localities, rng = walks.plant(seed + 100)
    related, n = oracles.relation(localities[locality], len(landmarks)), len(landmarks)
    walk = RelocationWalk(ALL, scan, landmarks, localities[locality])
    for _ in walks.walk_randomly(walk, rng):
        path, i = walks.pairs_of(walk), walk.measurement
        later = range(i + 1, len(scan))

        def keeps(k, j, path=path, i=i):
            extended = [*path, (i, j)]
            return any(
                oracles.legal(scan, landmarks, P, related, path, (k, l), 0.99)
                and oracles.legal(scan, landmarks, P, related, extended, (k, l), 0.99)
                for l in range(n)
            )

        expected = [sum(keeps(k, j) for k in later) for j in walk.offer.features.tolist()]
        assert walk.offer.support.tolist() == expected
        order = sorted(range(len(expected)), key=lambda c: (-expected[c], walk.offer.mean[c]))
        assert order == list(range(len(expected)))
        local = [np.mean([related is None or related[j, l] for _, l in path] or [1.0]) for j in walk.offer.features]
        np.testing.assert_allclose(walk.offer.local, local)


@for_seeds(20)
def test_distances_of_a_candidate_are_those_of_the_binary_constraint(seed):
    scan, landmarks, P, _, rng = walks.plant(seed + 200)
    walk = RelocationWalk(ALL, scan, landmarks)
    for _ in walks.walk_randomly(walk, rng):
        for j, mean, worst in zip(walk.offer.features.tolist(), walk.offer.mean, walk.offer.worst):
            squares = []
            for k, l in walks.pairs_of(walk):
                along = scan.points[k] - scan.points[walk.measurement]
                between = landmarks.positions[l] - landmarks.positions[j]
                u, v = along / np.linalg.norm(along), between / np.linalg.norm(between)
                D = differences(np.array([[j, l]]), len(landmarks))
                of_scan = scan.covariances[k] + scan.covariances[walk.measurement]
                variance = u @ of_scan @ u + v @ D @ P @ D.T @ v
                squares.append((np.linalg.norm(along) - np.linalg.norm(between)) ** 2 / variance)
            np.testing.assert_allclose([mean, worst], [np.mean(squares or [0]), max(squares, default=0)], rtol=1e-6)


@for_seeds(10)
def test_no_hypothesis_below_a_node_exceeds_its_bound(seed):
    scan, landmarks, P, localities, rng = walks.plant(seed + 300)
    locality = localities["covisibility"]
    best = max((len(pairs) for pairs in oracles.gcbb(scan, landmarks, P, locality, 0.99)), default=0)
    walk = RelocationWalk(ALL, scan, landmarks, locality)
    assert walk.node.bound_without(None) >= best
    bounds = [(walk.node.bound_without(None), len(walk.offer.features)) for _ in walks.walk_randomly(walk, rng)]
    assert all(b >= walk.node.pairings for b, _ in bounds)
    assert [b for b, _ in bounds] == sorted((b for b, _ in bounds), reverse=True)
