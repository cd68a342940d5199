"""A pose is accepted where the network says so; what the network is told does not depend on where the map begins."""

import dataclasses
import math

import numpy as np
import pytest

from slam_gym import Landmarks, Scan, gcbb, learned_relocation, weights
from slam_gym.association import resolve_relocator
from slam_gym.association.learned.acceptance import INPUTS, VERSION, WEIGHTS, inputs_of, of_mirror_image
from slam_gym.association.learned.network import shapes_for
from slam_gym.geometry import observe, transform


def place(seed: int, n: int = 40, m: int = 9, spurious: int = 2) -> tuple[Scan, Landmarks, np.ndarray]:
    """A scan of some of n landmarks at random, from a pose (3,)."""
    rng = np.random.default_rng(seed)
    at, pose = rng.uniform(0.0, 20.0, (n, 2)), np.array([10.0, 10.0, rng.uniform(-3.0, 3.0)])
    near = np.argsort(np.hypot(*(at - pose[:2]).T))[: m - spurious]
    seen = np.concatenate([observe(pose, at[near]), rng.uniform(-5.0, 5.0, (spurious, 2))])
    sizes = rng.uniform(0.2, 1.0, n)
    measured = np.concatenate([sizes[near], rng.uniform(0.2, 1.0, spurious)])
    scan = Scan.from_points(seen + 0.02 * rng.standard_normal((m, 2)), sigma=0.02, sizes=measured, size_sigma=0.05)
    return scan, Landmarks.from_points(at, sigma=0.02, sizes=sizes, size_sigma=0.02), pose


@pytest.mark.parametrize("seed", range(8))
def test_it_knows_where_it_is_and_where_it_is_not(seed):
    scan, landmarks, pose = place(seed)
    found = learned_relocation(scan, landmarks)
    assert found.accepted and np.hypot(*(found.pose - pose)[:2]) < 0.1
    _, other, _ = place(1000 + seed)
    refused = learned_relocation(scan, other)
    assert (not refused.accepted and refused.min_pairings == refused.pairings + 1) or refused.pairings < 3


def test_cost_decides():
    answers = [place(seed, m=6, spurious=2)[:2] for seed in range(12)]
    cheap, dear = ([learned_relocation(*a, cost=cost).accepted for a in answers] for cost in (1e-3, 1e6))
    assert sum(cheap) > sum(dear) and all(c or not d for c, d in zip(cheap, dear))
    with pytest.raises(ValueError, match="cost: "):
        learned_relocation(*answers[0], cost=0.0)


def test_inputs_are_those_of_the_answer():
    scan, landmarks, _ = place(0)
    found = gcbb(scan, landmarks, min_pairings=3)
    told = dict(zip(INPUTS, inputs_of(scan, landmarks, found, 3)))
    assert told["pairings"] == found.pairings == 7 and told["pairings of the measurements"] == pytest.approx(7 / 9)
    assert told["pairings beyond those of the mirror image"] == 4.0
    assert told["D² by its degrees of freedom"] == pytest.approx(found.joint_distance / 11)
    assert told["sizes: whether any are known"] == 1.0 and told["pairings of the landmarks that lie among them"] > 0.5
    nameless = dataclasses.replace(scan, sizes=np.full(9, math.nan), size_variances=np.full(9, math.nan))
    assert dict(zip(INPUTS, inputs_of(nameless, landmarks, found, 3)))["sizes: whether any are known"] == 0.0


def test_where_the_map_begins_says_nothing():
    scan, landmarks, _ = place(3)
    base = np.array([4.0, -2.0, 1.0])
    moved = dataclasses.replace(landmarks, positions=transform(base, landmarks.positions))
    first, second = (inputs_of(scan, m, gcbb(scan, m, min_pairings=3), 3) for m in (landmarks, moved))
    some = [k for k, name in enumerate(INPUTS) if "landmarks around" not in name and "chance" not in name]
    np.testing.assert_allclose(first[some], second[some], atol=1e-6)  # crowding is counted in cells


def test_a_symmetric_map_has_a_mirror_image():
    corners = np.array([[x, y] for x in (0.0, 4.0) for y in (0.0, 3.0)])
    landmarks = Landmarks.from_points(corners, sigma=0.02)
    scan = Scan.from_points(corners - [2.0, 1.5], sigma=0.02)
    assert of_mirror_image(scan, landmarks, None, 0.99, 10_000) == 4
    scattered, others, _ = place(5)
    assert of_mirror_image(scattered, others, None, 0.99, 100_000) < 6


def test_it_goes_by_its_name_and_its_weights_are_for_its_inputs():
    assert resolve_relocator("learned") is learned_relocation
    weights.load(WEIGHTS, VERSION, INPUTS, shapes_for(len(INPUTS)))
    with pytest.raises(ValueError, match="made for other inputs"):
        weights.load(WEIGHTS, VERSION, INPUTS[1:], shapes_for(len(INPUTS)))
