"""The loops against the formula, written out with numpy."""

import numpy as np
import pytest

from slam_gym.association.tracking.network import FARTHEST, Network, log_odds, network_of, shapes_for


def drawn(rng: np.random.Generator, n: int, h: int) -> dict[str, np.ndarray]:
    shapes = {name: tuple(h if side == -1 else side for side in shape) for name, shape in shapes_for(n).items()}
    arrays = {name: rng.normal(size=shape) for name, shape in (shapes | {"second": (h, 3 * h)}).items()}
    return arrays | {"scale": rng.uniform(0.5, 2.0, n)}


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
    network = network_of(drawn(rng, 7, 5))
    inputs, measured, slots = 3.0 * rng.normal(size=(20, 7)), rng.integers(0, 6, 20), rng.integers(0, 9, 20)
    expected = by_formula(network, inputs, measured, slots)
    np.testing.assert_allclose(log_odds(network, inputs, measured, slots), expected, atol=1e-9)


def test_weights_that_do_not_fit_each_other_are_refused():
    arrays = drawn(np.random.default_rng(0), 4, 3)
    for name, array, message in (
        ("second", np.zeros((3, 8)), "second: 8 columns, expected 9"),
        ("last", np.zeros(2), "not 2 hidden numbers everywhere"),
        ("scale", np.zeros(4), "scale: not positive"),
    ):
        with pytest.raises(ValueError, match=message):
            network_of(arrays | {name: array})
