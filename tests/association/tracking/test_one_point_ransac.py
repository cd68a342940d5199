"""1-point RANSAC against brute force over its anchors."""

import functools

import numpy as np

from slam_gym.association import one_point_ransac
from slam_gym.types import UNPAIRED
from tests.oracles import association as oracles
from tests.oracles.statistics import for_seeds


def nearest_first(distances, gate, taken):
    """Pairings within the gate by ascending distance, each measurement and feature once."""
    measured, features, out = {i for i, _ in taken}, {j for _, j in taken}, []
    for d2, (i, j) in sorted((d2, pair) for pair, d2 in distances.items()):
        if d2 < gate and i not in measured and j not in features:
            measured.add(i), features.add(j)
            out.append((d2, (i, j)))
    return out


def one_point(scan, prediction, confidence, allowed, given, related):
    """All anchors tried."""
    gate = oracles.gate(2, confidence)
    base = [(i, j) for i, j in enumerate(given) if j != UNPAIRED]
    lists = oracles.compatible(scan, prediction, confidence)
    candidates = [(i, j) for i, found in enumerate(lists) for _, j in found if given[i] == UNPAIRED and allowed[j]]

    def others(anchor):
        return [c for c in candidates if related is None or related[anchor[1], c[1]]]

    best = (0, 0.0, [])
    for a in candidates:
        if oracles.conditioned(scan, prediction, base, a) >= gate:
            continue  # it disagrees with the pairings that are given
        distances = {
            c: oracles.conditioned(scan, prediction, [*base, a], c) for c in others(a) if c[0] != a[0] and c[1] != a[1]
        }
        found = [(oracles.conditioned(scan, prediction, base, a), a), *nearest_first(distances, gate, [a])]
        best = min(best, (-len(found), sum(d2 for d2, _ in found), [pair for _, pair in found]))
    pairs = best[2]
    rows = list(given)
    if pairs:
        left = {
            c: oracles.conditioned(scan, prediction, [*base, *pairs], c) for c in others(pairs[0]) if c not in pairs
        }
        left = {c: d2 for c, d2 in left.items() if c[0] not in dict(pairs) and c[1] not in [j for _, j in pairs]}
        pairs = [*pairs, *(pair for _, pair in nearest_first(left, gate, pairs))]
    for i, j in pairs:
        rows[i] = j
    return rows


@for_seeds(100)
def test_one_point_ransac_finds_the_best_anchor_when_all_are_drawn(seed):
    scan, prediction, confidence = oracles.smaller_problem(1000 + seed, locality=seed % 2 == 0)
    rows = oracles.near_first(prediction, len(scan), functools.partial(one_point, scan, prediction, confidence))
    for shuffle in range(3):
        answer = one_point_ransac(scan, prediction, success=1.0 - 1e-15, seed=shuffle)
        oracles.check(answer, scan, prediction, rows)


def test_one_point_ransac_stops_early_and_says_when_it_was_stopped():
    scan, prediction = oracles.problem(np.random.default_rng(5), 12, 14, spread=2.0, spurious=0.1)
    everything = one_point_ransac(scan, prediction, success=1.0 - 1e-15)
    early = one_point_ransac(scan, prediction)
    assert early.effort.tries < everything.effort.tries
    assert early.dof == everything.dof
    stopped = one_point_ransac(scan, prediction, tries=2)
    assert stopped.effort.tries == 2 and stopped.effort.limit_hit and not early.effort.limit_hit
