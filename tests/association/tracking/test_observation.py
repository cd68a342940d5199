"""What a walk shows to a policy: scaled, fresh, and what it says."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association.tracking.walk import CANDIDATE_FIELDS, CLUTTER_DENSITY, PATH_FIELDS, nothing
from tests.association.tracking.test_walk import CONFIDENCE, problems, walked
from tests.oracles import association as oracles
from tests.oracles.densities import fit


@pytest.mark.parametrize("locality", [False, True])
def test_observations_are_finite_scaled_fresh_and_as_long_as_said(locality):
    rng = np.random.default_rng(1)
    for scan, prediction in problems(30, locality=locality):
        k = len(prediction)
        prediction.expected.sizes[:], prediction.expected.size_variances[:] = rng.uniform(0.1, 1.0, k), 0.01
        prediction.expected.ages[:] = np.arange(k)
        sizes = np.where(rng.random(len(scan)) < 0.5, np.nan, 0.3)
        scan = replace(scan, sizes=sizes, size_variances=np.full(len(scan), 0.01))
        lengths = {name: len(vector) for name, vector in nothing(4).items()}
        for walk, _ in walked(scan, prediction, rng, candidates=4):
            seen, again = walk.observation(), walk.observation()
            assert {name: len(vector) for name, vector in seen.items()} == lengths
            for name, vector in seen.items():
                assert vector.dtype == np.float32
                assert np.abs(vector).max() <= 1.0
                assert vector is not again[name]
                np.testing.assert_array_equal(vector, again[name])
        assert all(not vector.any() for vector in walk.observation().values())


def test_candidates_show_what_they_say():
    rng, checked = np.random.default_rng(2), 0
    for scan, prediction in problems(40, locality=True):
        prediction.expected.ages[:] = rng.integers(0, 300, len(prediction))
        compatible = oracles.compatible(scan, prediction, CONFIDENCE)
        related = prediction.local(np.arange(len(prediction)))
        for walk, pairs in walked(scan, prediction, rng, candidates=9):
            table = walk.observation()["candidates"].reshape(9, -1)
            column = dict(zip(CANDIDATE_FIELDS, table.T.astype(float)))
            path = dict(zip(PATH_FIELDS, walk.observation()["path"].astype(float)))
            k, later = len(walk.rows), walk.candidates.measurements[walk.level + 1 :].tolist()
            left = [i for i in later if compatible[i]]
            assert column["legal"].tolist() == [1.0] * k + [0.0] * (9 - k)
            np.testing.assert_allclose(_unsquash(path["left"], 10.0), len(left), atol=1e-4)
            np.testing.assert_allclose(_unsquash(path["pairings"], 10.0), len(pairs), atol=1e-4)
            without, odds = _outlook(scan, prediction, compatible, pairs, left), []
            for c, row in enumerate(walk.rows.tolist()):
                longer = [*pairs, (walk.measurement, row)]
                gate = oracles.gate(2 * len(longer), CONFIDENCE)
                distance = oracles.distance(scan, prediction, longer)
                assert _unsquash(column["joint"][c], gate) == pytest.approx(distance, rel=1e-4)
                assert _unsquash(column["age"][c], 50.0) == pytest.approx(prediction.ages[row], rel=1e-3)
                assert column["near"][c] == prediction.near[row]
                assert column["size"][c] == -1.0
                covisible = np.mean([related[row, used] for _, used in pairs]) if pairs else 0.0
                assert column["covisible"][c] == pytest.approx(covisible)
                rivals = sum(any(j == row for _, j in compatible[i]) for i in later)
                assert _unsquash(column["rivals"][c], 3.0) == pytest.approx(rivals, abs=1e-4)
                evidence = _evidence(scan, prediction, pairs, longer[-1])
                outlook = _outlook(scan, prediction, compatible, longer, left) - without
                assert _unsquash(column["evidence"][c], 5.0) == pytest.approx(evidence, rel=1e-3, abs=1e-3)
                assert _unsquash(column["outlook"][c], 5.0) == pytest.approx(outlook, rel=1e-3, abs=1e-3)
                odds.append(evidence + outlook)
                checked += 1
            for c, own in enumerate(odds):
                assert _unsquash(column["odds"][c], 5.0) == pytest.approx(own, rel=1e-3, abs=1e-3)
                best = max([0.0, *odds[:c], *odds[c + 1 :]])
                assert _unsquash(column["margin"][c], 5.0) == pytest.approx(own - best, rel=1e-3, abs=1e-3)
    assert checked > 200


def _unsquash(value, scale):
    return scale * value / (1.0 - abs(value))


def _evidence(scan, prediction, pairs, pair):
    """log N of a pair's innovation given other pairs, over the density of what is not in the map."""
    return fit(scan, prediction, [*pairs, pair]) - fit(scan, prediction, pairs) - np.log(CLUTTER_DENSITY)


def _outlook(scan, prediction, compatible, pairs, left):
    """Evidence of the measurements left, each by its best pair."""
    used = {j for _, j in pairs}
    free = [[_evidence(scan, prediction, pairs, (i, j)) for _, j in compatible[i] if j not in used] for i in left]
    return sum(max(0.0, *each, 0.0) for each in free)
