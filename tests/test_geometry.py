"""SE(2): group laws, angles at the seam, every Jacobian against finite differences."""

import math

import numpy as np
import pytest

from slam_gym import geometry as g
from slam_gym.types import Array
from tests.oracles.geometry import numerical

RNG = np.random.default_rng(0)
POSES = [np.array([x, y, t]) for x, y, t in np.column_stack([RNG.normal(0, 10, (12, 2)), RNG.uniform(-3.1, 3.1, 12)])]
SEAM = [np.array([1.0, -2.0, math.pi]), np.array([-3.0, 0.5, -3.141592]), np.array([0.0, 0.0, math.pi / 2])]
PAIRS = [*zip(POSES[:6], POSES[6:]), *zip(SEAM, SEAM[1:] + SEAM[:1])]
IDENTITY = np.zeros(3)


def matrix(pose: Array) -> Array:
    """The homogeneous matrix of a pose: what every function here must agree with."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


def assert_same(a: Array, b: Array) -> None:
    np.testing.assert_allclose(matrix(a), matrix(b), rtol=0, atol=1e-12)
    assert -math.pi < a[2] <= math.pi and -math.pi < b[2] <= math.pi


# --- angles -----------------------------------------------------------------------------------------------------------


def test_wrapped_angles_lie_in_the_half_open_interval() -> None:
    assert g.wrap_angle(math.pi) == g.wrap_angle(-math.pi) == math.pi
    around = [k * math.pi + d for k in range(-9, 10) for d in (-1e-15, 0.0, 1e-15, -1e-12, 1e-12)]
    seam = [np.nextafter(s * math.pi, to) for s in (1, -1) for to in (-10.0, 10.0)]
    wild = np.random.default_rng(1).normal(0, 1e6, 1000)
    for angle in (*around, *seam, *wild):
        wrapped = g.wrap_angle(angle)
        assert -math.pi < wrapped <= math.pi
        assert math.remainder(wrapped - angle, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


# --- group laws -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_composition_is_the_product_of_matrices(a: Array, b: Array) -> None:
    result = g.compose(a, b)
    np.testing.assert_allclose(matrix(result), matrix(a) @ matrix(b), rtol=0, atol=1e-12)
    assert -math.pi < result[2] <= math.pi


@pytest.mark.parametrize("a", POSES + SEAM)
def test_identity_and_inverse(a: Array) -> None:
    assert_same(g.compose(a, IDENTITY), a)
    assert_same(g.compose(IDENTITY, a), a)
    assert_same(g.compose(a, g.inverse(a)), IDENTITY)
    assert_same(g.compose(g.inverse(a), a), IDENTITY)
    assert_same(g.inverse(g.inverse(a)), a)


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_relative_undoes_composition(a: Array, b: Array) -> None:
    assert_same(g.relative(a, g.compose(a, b)), b)
    assert_same(g.compose(a, g.relative(a, b)), b)
    assert_same(g.inverse(g.compose(a, b)), g.compose(g.inverse(b), g.inverse(a)))


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_points_are_carried_along(a: Array, b: Array) -> None:
    points = np.random.default_rng(2).normal(0, 5, (7, 2))
    homogeneous = np.column_stack([points, np.ones(7)])
    np.testing.assert_allclose(g.transform(a, points), (homogeneous @ matrix(a).T)[:, :2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(g.observe(a, points), g.transform(g.inverse(a), points), rtol=0, atol=1e-12)
    np.testing.assert_allclose(g.observe(a, g.transform(a, points)), points, rtol=0, atol=1e-12)


# --- Jacobians --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_jacobians_of_composition(a: Array, b: Array) -> None:
    ja, jb = g.compose_jacobians(a, b)
    np.testing.assert_allclose(ja, numerical(lambda x: g.compose(x, b), a, wrapped=2), rtol=0, atol=1e-7)
    np.testing.assert_allclose(jb, numerical(lambda x: g.compose(a, x), b, wrapped=2), rtol=0, atol=1e-7)


@pytest.mark.parametrize("heading", [-3.0, -1.0, 0.0, 0.7, math.pi / 2, math.pi])
def test_covariances_turn_with_the_frame(heading: float) -> None:
    factors = np.random.default_rng(3).normal(size=(5, 2, 2))
    covariances = factors @ factors.transpose(0, 2, 1)
    c, s = math.cos(heading), math.sin(heading)
    C = np.array([[c, -s], [s, c]])
    turned = g.rotate_covariances(heading, covariances)
    np.testing.assert_allclose(turned, C @ covariances @ C.T, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(turned, turned.transpose(0, 2, 1))
    np.testing.assert_allclose(g.rotate_covariances(-heading, turned), covariances, rtol=0, atol=1e-13)
