"""Where scans come from, and what may be hidden of them."""

import dataclasses

import numpy as np

from agents.learning.associator.sources import (
    HIDDEN,
    LEVELS,
    LOGS,
    LOOPS,
    VIEWS,
    VIEWS_AND_SIZES,
    SeenAs,
    Source,
    without,
)
from slam_gym.association.learned.inputs import INPUTS
from slam_gym.scenarios import get_scenario
from slam_gym.types import UNLABELLED, UNPAIRED
from tests.association.learned.test_inputs import told


def test_every_capability_and_every_drift_is_looked_at():
    assert len(LEVELS) == 35 and {get_scenario(name).name for name in LOOPS} == set(LOOPS)
    assert {"drift-1", "drift-2", "drift-3", "crowd"} <= set(LOOPS) and len(LOGS) == 4


def test_what_is_hidden_is_not_there():
    scan, prediction = told()
    prediction = dataclasses.replace(prediction, view=lambda p, c: np.ones(len(p)))
    assert without("nothing", scan, prediction) == (scan, prediction)
    for hidden in HIDDEN[1:]:
        bare_scan, bare = without(hidden, scan, prediction)
        assert np.isnan(bare_scan.sizes).all() and np.isnan(bare.sizes).all()
        assert (bare.view is None) == (bare.sightings is None) == (hidden == "all but places")
        np.testing.assert_array_equal(bare.positions, prediction.positions)
    for hidden in (VIEWS, VIEWS_AND_SIZES):
        bare_scan, bare = without(hidden, scan, prediction)
        assert bare.view is None and bare.sightings is prediction.sightings
        assert np.isnan(bare_scan.sizes).all() == np.isnan(bare.sizes).all() == (hidden == VIEWS_AND_SIZES)


def test_a_feature_is_what_it_has_mostly_been_seen_as():
    seen, ids = SeenAs(), np.array([7, 3, 5])
    assert seen.source_of(ids, np.array([10, 11, -1])).tolist() == [10, 11, -1]
    seen.add(ids, np.array([0, UNPAIRED, 2]), np.array([20, 11, 30]))
    assert seen.source_of(ids, np.array([10, 11, -1])).tolist() == [10, 11, -1]  # as often as not
    seen.add(ids, np.array([2, 0, 0]), np.array([30, 20, UNLABELLED]))
    assert seen.source_of(ids[::-1], np.array([-1, 11, 10])).tolist() == [30, 11, 20]


def test_a_level_gives_scans_of_train_worlds_with_kinds_where_they_are_told():
    plain = list(Source("level", "closure/2", 0).scans(count=3))
    kinds = list(Source("level", "closure/2", 0, hidden="sizes, but for kinds").scans(count=3))
    assert len(plain) == len(kinds) == 3
    same, known = INPUTS.index("kind: the same"), INPUTS.index("size: whether both are known")
    assert plain[0].inputs[:, known].all() and not plain[0].inputs[:, same].any()
    assert kinds[0].inputs[:, same].any() and not kinds[0].inputs[:, known].any()
    assert all(d.right[d.inputs[:, INPUTS.index("kind: another")] > 0].sum() == 0 for d in kinds)
