"""What holds of every associator, on good input and bad; and how associators are named."""

import dataclasses
import inspect
import math
import pickle

import numpy as np
import pytest

from slam_gym.association import (
    ASSOCIATORS,
    gcbb,
    global_nearest_neighbour,
    ipjc,
    jcbb,
    learned_associator,
    map_hypothesis,
    marginal,
    nearest_neighbour,
    one_point_ransac,
    resolve_associator,
    resolve_relocator,
    singles,
)
from slam_gym.association.prediction import Prediction
from slam_gym.slam.slam import Slam
from slam_gym.types import UNPAIRED, Landmarks, Odometry, Scan
from tests.oracles import association as oracles
from tests.oracles.statistics import for_seeds

BLIND = [associator for name, associator in ASSOCIATORS.items() if name != "true_association"]
SEARCHES = [global_nearest_neighbour, one_point_ransac, ipjc, map_hypothesis, marginal, learned_associator]


@pytest.mark.parametrize("associator", BLIND)
@pytest.mark.parametrize(("m", "n"), [(0, 0), (0, 4), (4, 0)])
def test_nothing_to_associate(associator, m, n):
    answer = associator(*oracles.problem(np.random.default_rng(0), m, n))
    assert answer.features.tolist() == [UNPAIRED] * m
    assert (answer.joint_distance, answer.dof) == (0.0, 0)


@pytest.mark.parametrize("associator", BLIND)
@pytest.mark.parametrize(("m", "n"), [(8, 12), (1, 1), (1, 8), (12, 2), (9, 1)])
@for_seeds(20)
def test_what_holds_of_every_associator(associator, m, n, seed):
    """Pairings are individually compatible, the distance is theirs, and the arguments are left as they were."""
    scan, prediction = oracles.problem(np.random.default_rng(seed), m, n, spread=2.0, locality=seed % 2 == 0)
    before = pickle.dumps((scan, prediction.positions, prediction.covariances, prediction.features))
    answer = associator(scan, prediction)
    assert pickle.dumps((scan, prediction.positions, prediction.covariances, prediction.features)) == before
    assert answer.features.dtype == np.int64 and answer.features.shape == (m,)
    row_of = {int(feature): row for row, feature in enumerate(prediction.features)} | {UNPAIRED: UNPAIRED}
    rows = [row_of[int(feature)] for feature in answer.features]
    oracles.check(answer, scan, prediction, rows)
    gate = 0.999 if associator in (map_hypothesis, marginal, learned_associator) else 0.99
    for row, found in zip(rows, oracles.compatible(scan, prediction, gate)):
        assert row == UNPAIRED or row in [j for _, j in found]
    assert associator is nearest_neighbour or len(set(rows) - {UNPAIRED}) == answer.pairings
    again = associator(scan, prediction)
    assert again.features.tolist() == answer.features.tolist() and again.effort == answer.effort


def test_associators_are_found_by_name_by_module_or_as_themselves():
    assert resolve_associator("jcbb") is jcbb and resolve_associator("learned") is learned_associator
    assert resolve_associator("slam_gym.association.tracking.nearest_neighbour:singles") is singles
    assert resolve_associator(nearest_neighbour) is nearest_neighbour
    for associator in ASSOCIATORS.values():
        assert pickle.loads(pickle.dumps(associator)) is associator


@pytest.mark.parametrize(
    "name", ["icp", "", "no.such.module:function", "slam_gym.association:nothing", "slam_gym.association:__all__", ":x"]
)
def test_an_unknown_associator_lists_the_known_ones(name):
    with pytest.raises(ValueError, match=r"known: .*jcbb, .*nearest_neighbour, .*singles, true_association"):
        resolve_associator(name)


def test_only_true_association_can_be_given_the_truth():
    for name, associator in ASSOCIATORS.items():
        assert ("sources" in inspect.signature(associator).parameters) == (name == "true_association")


@pytest.mark.parametrize("search", SEARCHES)
def test_numbers_that_are_none_are_named(search):
    scan, prediction = oracles.problem(np.random.default_rng(0), 4, 5)
    none = np.full((2, 2), math.nan), np.full((2, 2), math.inf), -np.eye(2), [[1.0, 2.0], [2.0, 1.0]]
    for where, values in (("points", (math.nan, math.inf)), ("covariances", none)):
        for value in values:
            spoilt = getattr(scan, where).copy()
            spoilt[2] = value
            with pytest.raises(ValueError, match=rf"scan.{where}\[2\]"):
                search(dataclasses.replace(scan, **{where: spoilt}), prediction)
    certain = Prediction.from_gaussian(np.tile(scan.points[:1], (5, 1)), np.ones((10, 10)))
    with pytest.raises(ValueError, match="singular"):
        search(dataclasses.replace(scan, covariances=np.zeros((4, 2, 2))), certain)


@pytest.mark.parametrize("search", SEARCHES)
def test_exact_measurements_are_paired_as_those_with_a_tiny_error(search):
    places, paired = np.array([[2.0, 1.0], [3.0, -1.0], [4.0, 2.0], [1.0, -2.0]]), []
    for sigma in (0.0, 1e-6):
        slam = Slam()
        for k in range(4):
            odometry = Odometry.from_motion([0.1 * (k > 0), 0.0, 0.0], 0.01 * (k > 0))
            step = slam.step(odometry, Scan.from_points(places - [0.1 * k, 0.0], sigma=sigma), search)
            paired.append(step.hypothesis.features.tolist())
    assert paired[:4] == paired[4:] and paired[3] == [0, 1, 2, 3]


@pytest.mark.parametrize("search", [s for s in SEARCHES if s not in (marginal, learned_associator)])  # which refuse
def test_duplicate_features_and_features_on_a_line_are_paired_once_each(search):
    rng = np.random.default_rng(1)
    line = np.column_stack([np.arange(6.0), np.zeros(6)])
    at = np.concatenate([line, line])  # every feature twice, at one place
    prediction = Prediction.from_gaussian(at, 0.01 * np.ones((24, 24)) + 1e-4 * np.eye(24))
    scan = Scan.from_points(line + 0.01 * rng.standard_normal((6, 2)), sigma=0.01)
    answer = search(scan, prediction)
    assert (answer.features % 6).tolist() == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("search", "options"),
    [
        (one_point_ransac, {"tries": 0}),
        (one_point_ransac, {"success": 1.0}),
        (ipjc, {"node_limit": 0}),
        (jcbb, {"node_limit": 0}),
        (map_hypothesis, {"detection": 1.0}),
        (map_hypothesis, {"detection": math.nan}),
        (map_hypothesis, {"density": 0.0}),
        (map_hypothesis, {"density": math.inf}),
        (map_hypothesis, {"width": 0}),
        (map_hypothesis, {"margin": 0.0}),
        (marginal, {"cost": 0.9}),
        (marginal, {"cost": math.inf}),
        (marginal, {"provisional_cost": 0.9}),
        (marginal, {"width": 0}),
        (marginal, {"margin": 0.0}),
        (learned_associator, {"cost": 0.5}),
    ],
)
def test_meaningless_options_are_refused(search, options):
    scan, prediction = oracles.problem(np.random.default_rng(0), 3, 3)
    with pytest.raises(ValueError, match=next(iter(options))):
        search(scan, prediction, **options)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 1.5, np.nan])
def test_a_confidence_that_is_none_is_refused(confidence):
    scan, prediction = oracles.problem(np.random.default_rng(0), 3, 3, confidence=confidence)
    with pytest.raises(ValueError, match="confidence"):
        jcbb(scan, prediction)


def test_relocators_are_found_by_name_by_module_or_as_themselves():
    assert resolve_relocator("gcbb") is gcbb and resolve_relocator(gcbb) is gcbb
    assert resolve_relocator("slam_gym.association.relocation.gcbb:gcbb") is gcbb
    with pytest.raises(ValueError, match="random_sampling"):
        resolve_relocator("nothing")


@pytest.mark.parametrize(
    "changed", [{"covariance": np.tri(3)}, {"pose": np.full(3, np.nan)}, {"features": np.zeros(9)}]
)
def test_what_is_no_relocation_is_refused_by_the_name_of_the_relocator(changed):
    scan, landmarks = Scan.from_points(np.eye(2), sigma=0.1), Landmarks.from_points(np.eye(2), sigma=0.1)

    def mine(*problem):
        return dataclasses.replace(gcbb(*problem), min_pairings=0, ambiguous=False, **changed)

    with pytest.raises(ValueError, match=f"relocator mine: .*{next(iter(changed))}"):
        resolve_relocator(mine)(scan, landmarks, None)
