"""What the learned associator does beyond `marginal`, and what it makes of weights."""

import dataclasses

import numpy as np
import pytest

from slam_gym import Slam, learned_associator, marginal, weights
from slam_gym.association import resolve_associator
from slam_gym.association.learned.associator import WEIGHTS, learned_odds
from slam_gym.association.learned.inputs import INPUTS, VERSION
from slam_gym.association.learned.network import shapes_for
from slam_gym.types import UNKNOWN_KIND, UNPAIRED, Odometry, Prediction, Scan
from tests.oracles import association as oracles


def problem(seed):
    """Eight measurements before ten features, sizes and all."""
    rng = np.random.default_rng(seed)
    scan, prediction = oracles.problem(rng, 8, 10, spread=2.0)
    few, many = ({"sizes": rng.uniform(0.2, 1.0, k), "size_variances": np.full(k, 0.01)} for k in (8, 10))
    return dataclasses.replace(scan, **few), dataclasses.replace(prediction, **many)


def test_it_goes_by_its_name_wherever_associators_do():
    assert resolve_associator("learned") is learned_associator
    world, slam = np.array([[2.0, 1.0], [3.0, -1.0], [5.0, 0.5], [4.0, 2.0]]), Slam()
    for k in range(4):
        odometry = Odometry.from_motion([0.3 if k else 0.0, 0, 0], 0.02)
        step = slam.step(odometry, Scan.from_points(world - [0.3 * k, 0], sigma=0.05), "learned")
    assert len(slam.map) == 4 and step.hypothesis.pairings == 4
    assert step.prediction.experience is not None and step.prediction.sightings.tolist() == [3] * 4


def test_sizes_tell_apart_what_places_do_not():
    """Two features, each as near as the other: `marginal` refuses, and so does the learned one without sizes."""
    at = [[1.0, 0.2], [1.0, -0.2], [2.0, 1.5], [3.0, -1.0], [2.5, 0.5]]
    prediction = Prediction.from_gaussian(at, 0.02 * np.eye(10), sizes=[0.2, 0.9, 0.5, 0.4, 0.3], size_sigma=0.02)
    prediction = dataclasses.replace(
        prediction, ages=np.full(5, 30), sightings=np.full(5, 12), provisional=np.zeros(5, np.bool_), view_moves=False,
        view=lambda p, c: np.full(len(p), 0.9),
    )  # fmt: skip
    seen = [[1.0, 0.0], [2.0, 1.5], [3.0, -1.0], [2.5, 0.5]]
    scan = Scan.from_points(seen, sigma=0.03, sizes=[0.21, 0.5, 0.4, 0.3], size_sigma=0.05)
    nameless = Scan.from_points(seen, sigma=0.03)
    assert marginal(scan, prediction).features.tolist() == [UNPAIRED, 2, 3, 4]
    assert learned_associator(scan, prediction).features.tolist() == [0, 2, 3, 4]
    assert learned_associator(nameless, prediction).features.tolist() == [UNPAIRED, 2, 3, 4]


@pytest.mark.parametrize("seed", range(10))
def test_an_answer_depends_neither_on_the_order_of_features_nor_on_where_the_map_begins(seed):
    scan, prediction = problem(seed)
    order = np.random.default_rng(seed).permutation(10)
    first, second = learned_associator(scan, prediction), learned_associator(scan, prediction.rows(order))
    assert first.features.tolist() == second.features.tolist()
    np.testing.assert_allclose(first.posterior.marginals, second.posterior.marginals, atol=1e-6)


@pytest.mark.parametrize("told", ["nothing", "sizes", "kinds", "view"])
def test_where_places_are_all_there_is_marginal_decides_alone(told):
    differ = 0
    for seed in range(10):
        (scan, prediction), nan = problem(seed), np.full(8, np.nan)
        sizes = {} if told == "sizes" else {"sizes": nan, "size_variances": nan}
        kinds = np.full(8, 1 if told == "kinds" else UNKNOWN_KIND)
        view = (lambda p, c: np.full(len(p), 0.5)) if told == "view" else None
        scan = dataclasses.replace(scan, **sizes, kinds=kinds)
        prediction = dataclasses.replace(prediction, view=view)
        own, other = learned_associator(scan, prediction), marginal(scan, prediction)
        differ += not np.array_equal(own.posterior.unpaired, other.posterior.unpaired)
    assert (differ == 0) == (told == "nothing")


def test_weights_for_other_inputs_are_refused_by_name():
    shapes = shapes_for(len(INPUTS))
    weights.load(WEIGHTS, VERSION, INPUTS, shapes)
    with pytest.raises(ValueError, match=f"weights associator.npz: made for version {VERSION} of the inputs"):
        weights.load(WEIGHTS, VERSION + 1, INPUTS, shapes)
    with pytest.raises(ValueError, match="made for other inputs"):
        weights.load(WEIGHTS, VERSION, (*INPUTS[:-1], "run: something else"), shapes)
    with pytest.raises(ValueError, match=r"weights .nonsense.: unknown; known: .*associator"):
        learned_odds("nonsense")


def test_the_network_is_small():
    network = learned_odds().network
    assert sum(array.size for array in network) < 50_000


def test_cost_is_that_of_marginal():
    scan, prediction = problem(1)
    cheap, dear = learned_associator(scan, prediction, cost=1.0), learned_associator(scan, prediction, cost=1e4)
    assert dear.pairings <= cheap.pairings
    with pytest.raises(ValueError, match="cost: "):
        learned_associator(scan, prediction, cost=0.5)
