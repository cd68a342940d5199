"""What the learned associator does beyond `marginal`, and what it makes of weights."""

import dataclasses
import math
import os

import numpy as np
import pytest

from slam_gym import learned_associator, marginal
from slam_gym.association.prediction import Prediction
from slam_gym.association.tracking import ppo as ppo_weights
from slam_gym.association.tracking.learned import WEIGHTS
from slam_gym.association.tracking.marginal import examples, weigh
from slam_gym.association.tracking.network import FARTHEST, INPUTS, SHAPES, Network, load_network, log_odds, network_of
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.types import UNKNOWN_KIND, UNPAIRED, Scan
from slam_gym.weights import load, write
from tests.oracles import association as oracles
from tests.oracles.statistics import for_seeds


def problem(seed):
    """Eight measurements before ten features, sizes and all."""
    rng = np.random.default_rng(seed)
    scan, prediction = oracles.problem(rng, 8, 10, spread=2.0)
    few = {"sizes": rng.uniform(0.2, 1.0, 8), "size_variances": np.full(8, 0.01)}
    known = prediction.expected._replace(sizes=rng.uniform(0.2, 1.0, 10), size_variances=np.full(10, 0.01))
    return dataclasses.replace(scan, **few), dataclasses.replace(prediction, expected=known)


def test_sizes_tell_apart_what_places_do_not():
    """Two features, each as near as the other: `marginal` refuses, and so does the learned one without sizes."""
    at = [[1.0, 0.2], [1.0, -0.2], [2.0, 1.5], [3.0, -1.0], [2.5, 0.5]]
    prediction = Prediction.from_gaussian(at, 0.02 * np.eye(10), sizes=[0.2, 0.9, 0.5, 0.4, 0.3], size_sigma=0.02)
    prediction.expected.ages[:], prediction.expected.sightings[:] = 30, 12
    prediction = prediction.with_visibility(np.full(5, 0.9))
    seen = [[1.0, 0.0], [2.0, 1.5], [3.0, -1.0], [2.5, 0.5]]
    scan = Scan.from_points(seen, sigma=0.03, sizes=[0.21, 0.5, 0.4, 0.3], size_sigma=0.05)
    nameless = Scan.from_points(seen, sigma=0.03)
    assert marginal(scan, prediction).features.tolist() == [UNPAIRED, 2, 3, 4]
    assert learned_associator(scan, prediction).features.tolist() == [0, 2, 3, 4]
    assert learned_associator(nameless, prediction).features.tolist() == [UNPAIRED, 2, 3, 4]


@for_seeds(10)
def test_learned_odds_are_added_to_every_hypothesis_that_makes_their_pairing(seed):
    scan, prediction = problem(seed)
    network, wide = load_network(WEIGHTS), {"width": 5000, "margin": 60.0}
    (example,) = examples(scan, prediction, **wide)
    slots = np.unique(example.rows, return_inverse=True)[1]
    odds = np.zeros((8, 11))
    odds[example.measured, example.rows] = log_odds(network, example.inputs, example.measured, slots)
    scores = example.log_densities + odds[np.arange(8), example.hypotheses].sum(axis=1)  # row UNPAIRED is the last
    weights = np.exp(scores - scores.max())
    expected = np.zeros((8, 11))
    for rows, weight in zip(example.hypotheses, weights / weights.sum()):
        expected[np.arange(8), rows] += weight
    found = weigh(scan, prediction, **wide, network=network)[1]
    assert found.pairings == pytest.approx(expected[:, :10], abs=1e-6)
    assert found.unpaired == pytest.approx(expected[:, 10], abs=1e-6)


@pytest.mark.parametrize("told", ["nothing", "sizes", "kinds", "view"])
def test_where_places_are_all_there_is_marginal_decides_alone(told):
    differ = 0
    for seed in range(10):
        (scan, prediction), nan = problem(seed), np.full(8, np.nan)
        sizes = {} if told == "sizes" else {"sizes": nan, "size_variances": nan}
        kinds = np.full(8, 1 if told == "kinds" else UNKNOWN_KIND)
        scan = dataclasses.replace(scan, **sizes, kinds=kinds)
        prediction = prediction.with_visibility(np.full(10, 0.5) if told == "view" else None)
        own, other = learned_associator(scan, prediction), marginal(scan, prediction)
        differ += not np.array_equal(own.posterior.unpaired, other.posterior.unpaired)
    assert (differ == 0) == (told == "nothing")


def test_whether_features_face_the_robot_is_an_input_where_the_view_is_known():
    (scan, prediction), facing = problem(1), np.linspace(0.1, 1.0, 10)
    seen = prediction.expected._replace(sight=ViewsFrom(2.0 * math.pi, 6.0).arrays, facing=facing)
    seen = dataclasses.replace(prediction, expected=seen)
    column = INPUTS.index("feature: probability that it faces the robot, 1 where nobody can tell")
    for told, expected in (
        (seen, facing), (seen.with_visibility(None), np.ones(10)), (seen.with_visibility(np.full(10, 0.5)), np.ones(10))
    ):  # fmt: skip
        (example,) = examples(scan, told, width=100, margin=12.0)
        assert example.inputs[:, column] == pytest.approx(expected[example.rows])


def test_a_size_without_its_variance_is_no_size():
    scan, prediction = problem(1)
    uncertain = dataclasses.replace(scan, size_variances=np.full(8, np.nan))
    unknown = dataclasses.replace(uncertain, sizes=np.full(8, np.nan))
    answers = [learned_associator(each, prediction).posterior for each in (uncertain, unknown)]
    np.testing.assert_array_equal(answers[0].unpaired, answers[1].unpaired)


# --- the network: its loops against the formula, written out with numpy -----------------------------------------------


def drawn(rng: np.random.Generator, h: int) -> dict[str, np.ndarray]:
    shapes = {name: tuple(h if side == -1 else side for side in shape) for name, shape in SHAPES.items()}
    arrays = {name: rng.normal(size=shape) for name, shape in (shapes | {"second": (h, 3 * h)}).items()}
    return arrays | {"scale": rng.uniform(0.5, 2.0, len(INPUTS))}


def by_formula(network: Network, inputs, measured, slots):
    given = (inputs - network.centre) / network.scale
    x = np.clip(given, -FARTHEST, FARTHEST)
    own = np.maximum(x @ network.first.T + network.first_offset, 0.0)
    most = [np.array([own[group == g].max(axis=0) for g in group]) for group in (measured, slots)]
    hidden = np.maximum(np.concatenate([own, *most], axis=1) @ network.second.T + network.second_offset, 0.0)
    return 0.5 ** (x != given).sum(axis=1) * (network.offset + x @ network.linear + hidden @ network.last)


@pytest.mark.parametrize("seed", range(5))
def test_the_loops_are_the_formula(seed):
    rng = np.random.default_rng(seed)
    network = network_of(drawn(rng, 5))
    inputs, measured, slots = 3.0 * rng.normal(size=(20, len(INPUTS))), rng.integers(0, 6, 20), rng.integers(0, 9, 20)
    expected = by_formula(network, inputs, measured, slots)
    np.testing.assert_allclose(log_odds(network, inputs, measured, slots), expected, atol=1e-9)


def test_weights_that_are_written_again_are_read_again(tmp_path):
    path, (scan, prediction) = tmp_path / "own.npz", problem(1)
    shipped = load("ppo", ppo_weights.VERSION, ppo_weights.INPUTS, ppo_weights.SHAPES)
    found = []
    for sign, when in ((1.0, 1), (-1.0, 2)):  # the branch of the least score in place of the greatest
        write(path, shipped._replace(arrays=shipped.arrays | {"w": sign * shipped.arrays["w"]}))
        os.utime(path, (when, when))
        found.append(ppo_weights.ppo(scan, prediction, weights=path).features.tolist())
    assert found[0] == ppo_weights.ppo(scan, prediction).features.tolist() != found[1]


def test_weights_that_do_not_fit_each_other_are_refused():
    arrays = drawn(np.random.default_rng(0), 3)
    for name, array, message in (
        ("second", np.zeros((3, 8)), "second: 8 columns, expected 9"),
        ("last", np.zeros(2), "not 2 hidden units everywhere"),
        ("scale", np.zeros(len(INPUTS)), "scale: not positive"),
    ):
        with pytest.raises(ValueError, match=message):
            network_of(arrays | {name: array})
