"""The virtual map against the equations written out, and the laws its criteria must keep."""

import math

import numpy as np
import pytest

from slam_gym.geometry import observe
from slam_gym.navigation.active_slam import VirtualMap
from slam_gym.types import Beams
from tests.oracles.geometry import transform_jacobians
from tests.oracles.statistics import random_covariance

BOUNDS = np.array([-6.0, -4.0, 7.0, 5.0])
BEARINGS = np.linspace(-math.pi, math.pi, 40, endpoint=False)
CLEAR = Beams(BEARINGS, np.full(40, 6.0), 6.0)


def centres(virtual):
    h, w = virtual.covariances.shape[:2]
    columns, rows = np.meshgrid(np.arange(w), np.arange(h))
    return virtual.origin + (np.stack([columns, rows], axis=-1) + 0.5) * virtual.cell


def observed(virtual):
    """(h, w) the virtual landmarks that are better known than before any observation."""
    return np.trace(virtual.covariances, axis1=2, axis2=3) < 2.0 * virtual.prior_sigma**2


def observed_by_hand(virtual, pose, covariance, beams, sigma):
    """The covariances that `observe` should leave, cell by cell with the Jacobians written out."""
    out = virtual.covariances.copy()
    half_gap = abs(beams.bearings[1] - beams.bearings[0]) / 2
    for index in np.ndindex(out.shape[:2]):
        z = observe(pose, centres(virtual)[index][None])[0]
        off = np.abs(np.angle(np.exp(1j * (math.atan2(z[1], z[0]) - beams.bearings))))
        k = off.argmin()
        if off[k] <= half_gap + 1e-9 and np.hypot(*z) <= min(beams.ranges[k], beams.max_range):
            J, _ = transform_jacobians(pose, z)
            candidate = J @ covariance @ J.T + sigma**2 * np.eye(2)
            if np.trace(candidate) < np.trace(out[index]):
                out[index] = candidate
    return out


@pytest.mark.parametrize("field_of_view", [2 * math.pi, 1.5 * math.pi, 1.0])
def test_observation_is_the_propagated_covariance_where_smaller(field_of_view):
    rng = np.random.default_rng(1)
    virtual = VirtualMap(BOUNDS, 0.8, prior_sigma=0.5)
    bearings = np.linspace(-field_of_view / 2, field_of_view / 2, 40, endpoint=field_of_view < 6)
    for _ in range(25):
        pose = np.array([*rng.uniform(-7, 7, 2), rng.uniform(-4, 4)])
        ranges = np.where(rng.random(40) < 0.3, 5.0, rng.uniform(0.0, 5.0, 40))
        beams, covariance = Beams(bearings, ranges, 5.0), random_covariance(rng, 3, 0.1)
        before = virtual.covariances.copy()
        expected = observed_by_hand(virtual, pose, covariance, beams, 0.05)
        improved = virtual.observe(pose, covariance, beams, 0.05)
        assert np.allclose(virtual.covariances, expected, rtol=1e-9, atol=1e-12)
        assert improved == (virtual.covariances != before).any(axis=(2, 3)).sum()
    assert 0 < observed(virtual).sum() < observed(virtual).size


def test_criteria_are_those_of_the_eigenvalues():
    rng = np.random.default_rng(2)
    virtual = VirtualMap(BOUNDS, 1.0, prior_sigma=0.7)
    assert virtual.a_opt() == pytest.approx(1.0) and virtual.d_opt() == pytest.approx(1.0)
    assert virtual.entropy() == pytest.approx(0.0, abs=1e-12)
    for _ in range(5):
        virtual.observe(rng.uniform(-3, 3, 3), random_covariance(rng, 3, 0.1), CLEAR, 0.03)
    eigenvalues = np.linalg.eigvalsh(virtual.covariances) / 0.7**2
    assert virtual.a_opt() == pytest.approx(eigenvalues.mean())
    assert virtual.d_opt() == pytest.approx(math.exp(np.log(eigenvalues).mean()))
    assert virtual.entropy() == pytest.approx(0.5 * np.log(eigenvalues).mean())
    assert virtual.d_opt() <= virtual.a_opt()


def test_nothing_bad_gets_in():
    virtual = VirtualMap(BOUNDS, 1.0, 1.0)
    before = virtual.covariances.copy()
    assert virtual.observe(np.zeros(3), np.full((3, 3), np.nan), CLEAR, 0.05) == 0
    assert virtual.observe(np.array([1e6, 0.0, 0.0]), np.zeros((3, 3)), CLEAR, 0.05) == 0
    assert virtual.observe(np.zeros(3), np.zeros((3, 3)), Beams(BEARINGS, np.full(40, np.nan), 6.0), 0.05) == 0
    assert np.array_equal(virtual.covariances, before)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (([0, 0, -1, 1],), "bounds"),
        (([0, 0, math.inf, 1],), "bounds"),
        (([0, 0, 1, 1], 0.0), "side of a cell"),
        (([0, 0, 1, 1], 1.0, math.nan), "prior_sigma"),
    ],
)
def test_absurd_maps_are_refused(arguments, name):
    with pytest.raises(ValueError, match=name):
        VirtualMap(np.array(arguments[0], dtype=float), *arguments[1:])
