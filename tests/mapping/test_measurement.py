"""What the map expects to measure, and what it tells of the heading, against the definitions."""

import math

import numpy as np
import pytest

from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.map_joining import join
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import Array, Odometry, Scan
from tests.mapping.small_maps import STILL, h, mapped, predicted
from tests.oracles.geometry import numerical, observe_jacobians
from tests.oracles.map import make_scan
from tests.oracles.statistics import for_seeds


@for_seeds(20)
def test_heading_is_the_variance_of_the_heading_and_its_covariance_with_what_is_predicted(seed):
    slam, *_ = mapped(MapSpec(), steps=10, seed=seed)
    prediction, rows = predicted(slam, math.inf), np.random.default_rng(seed).permutation(slam.n)[:7]
    variance, across = prediction.heading_variance, prediction.heading_covariances[rows]
    P, pose = slam.covariance, slam.pose
    assert variance == pytest.approx(P[2, 2])
    for row, got in zip(rows, across):
        H, f = np.zeros((2, len(P))), 3 + 2 * int(prediction.features[row])
        H[:, :3], H[:, f : f + 2] = observe_jacobians(pose, slam.mean[f : f + 2])
        np.testing.assert_allclose(got, H @ P[:, 2], rtol=1e-9, atol=1e-12)
    joint = np.block([[prediction.joint(rows), across.reshape(-1, 1)], [across.reshape(1, -1), variance]])
    assert np.linalg.eigvalsh(joint).min() > -1e-12  # of one Gaussian


def test_prediction_is_first_order_propagation_of_h() -> None:
    m, _, _ = mapped()
    prediction = predicted(m)
    assert len(prediction) == m.n
    H = numerical(lambda x: h(x, prediction.features), m.mean)
    expected = H @ m.covariance @ H.T
    np.testing.assert_allclose(prediction.positions.ravel(), h(m.mean, prediction.features), atol=1e-12)
    joint, rows = prediction.joint(np.arange(m.n)), np.array([6, 0, 6, 3])
    np.testing.assert_allclose(joint, expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(joint, joint.T)
    for j, marginal in enumerate(prediction.covariances):
        np.testing.assert_allclose(marginal, expected[2 * j : 2 * j + 2, 2 * j : 2 * j + 2], rtol=0, atol=1e-9)
    entries = np.column_stack([2 * rows, 2 * rows + 1]).ravel()  # any rows in any order
    np.testing.assert_allclose(prediction.joint(rows), joint[np.ix_(entries, entries)], rtol=0, atol=1e-15)


def test_reach_is_widened_by_three_sigma() -> None:
    m = StochasticMap()
    points = np.array([[4.9, 0.0], [5.2, 0.0], [0.0, 5.2], [-5.2, 0.0], [20.0, 0.0]])
    R = np.array([np.eye(2) * 0.01**2, np.eye(2) * 0.05**2, np.diag([0.01, 0.1]) ** 2, *[np.eye(2) * 0.08**2] * 2])
    m.add(make_scan(points, R), np.arange(5))
    prediction = predicted(m, 5.0)
    np.testing.assert_array_equal(prediction.features, [0, 2, 3])
    np.testing.assert_allclose(prediction.positions, points[[0, 2, 3]])
    np.testing.assert_allclose(prediction.covariances, R[[0, 2, 3]])


def facing(bearings: Array, *later: float, sigma: float = 0.0, base: float = 0.0) -> Array:
    """`facing` of a feature measured from `bearings` around it, for robots at `later` bearings, 3 m away and known to
    `sigma` [m], in a map whose base has been turned by `base`."""
    m = StochasticMap()
    for k, bearing in enumerate(bearings):
        m.place([5.0 + 3.0 * math.cos(bearing), 1.0 + 3.0 * math.sin(bearing), bearing + math.pi], np.zeros((3, 3)))
        scan = make_scan(np.array([[3.0, 0.0]]), 1e-6 * np.eye(2)[None])
        m.update(scan, np.array([0])) if k else m.add(scan, np.array([0]))
    m, out = join(StochasticMap(pose=[1.0, 2.0, base]), m), []
    for turned in np.array(later) + base:
        at = m.positions[0] + [3.0 * math.cos(turned), 3.0 * math.sin(turned)]
        m.place([*at, 0.0], sigma**2 * np.diag([1.0, 1.0, 0.0]))
        out.append(predicted(m).facing.item())
    return np.array(out)


def test_a_feature_faces_the_robot_where_it_was_seen_from_there() -> None:
    ahead, before = np.zeros(1), np.radians([0.0, 3.0, 90.0, 351.0])
    assert facing(before, *before).tolist() == [1.0] * 4
    angles = np.radians(np.arange(0, 91, 9))
    one_sided = facing(ahead, *angles)
    assert (np.diff(one_sided) <= 0.0).all() and 0.3 < one_sided[3] < 0.5  # at 27°
    np.testing.assert_allclose(facing(ahead, *-angles), one_sided, rtol=0.3)  # but for the width of a sector
    assert (facing(before, *angles) >= one_sided - 0.01).all() and facing(before, math.pi) < 0.04
    assert facing(ahead, 0.5) < facing(ahead, 0.5, sigma=0.5) < 1.0  # it may be nearer that direction


@for_seeds(20)
def test_directions_turn_with_the_base_of_a_map_that_is_joined(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bearings, later = rng.uniform(-math.pi, math.pi, (2, 3))
    base = rng.integers(-59, 60) * math.radians(6.0)
    np.testing.assert_allclose(facing(bearings, *later, base=base), facing(bearings, *later), rtol=0.3)


@pytest.mark.parametrize("locality", [True, False])
def test_motion_and_prediction_in_one_call_are_one_after_the_other(locality: bool) -> None:
    """With localities, near is what is local to the features that were lately paired."""
    moved = Odometry(np.array([0.3, 0.1, 0.2]), np.diag([1e-3, 2e-3, 3e-3]))
    together, graph = mapped()[0], CovisibilityGraph()
    apart = together.copy()
    graph.add(together.n)
    graph.see_together(np.array([0, 1, 5]))
    recent, local = np.array([1]), graph if locality else None
    one = predicted(together, 5.0, local, recent, moved)
    apart.predict(moved)
    other = predicted(apart, 5.0, local, recent)
    assert 5 < len(one) < together.n
    for name in ("features", "positions", "covariances", "sizes", "kinds", "ages", "near", "heading_covariances"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(together.covariance, apart.covariance)
    np.testing.assert_array_equal(one.near, np.isin(one.features, [0, 1, 5]) | (not locality))
    before = together.mean
    with pytest.raises(ValueError, match="odometry"):
        predicted(together, odometry=Odometry(np.array([0.0, np.nan, 0.0]), np.zeros((3, 3))))
    np.testing.assert_array_equal(together.mean, before)


@pytest.mark.parametrize("change", ["predict", "update", "add", "remove"])
def test_an_outdated_prediction_says_so(change: str) -> None:
    m, _, _ = mapped()
    prediction = predicted(m)
    scan = make_scan(prediction.positions[:1], np.tile(np.eye(2), (1, 1, 1)))
    changes = {
        "predict": lambda: m.predict(STILL),
        "update": lambda: m.update(scan, np.array([0])),
        "add": lambda: m.add(scan, np.array([0])),
        "remove": lambda: m.remove(np.array([0])),
    }
    prediction.joint(np.array([0]))
    changes[change]()
    with pytest.raises(RuntimeError, match="changed"):
        prediction.joint(np.array([0]))


# --- to second order --------------------------------------------------------------------------------------------------


def drawn_from(m: StochasticMap, draws: int, rng: np.random.Generator) -> Array:
    """(draws, 2n) what states drawn from the filter's Gaussian, in the coordinates of the group, would measure."""
    delta = rng.multivariate_normal(np.zeros(3 + 2 * m.n), m.covariance, draws, method="cholesky")
    turn = delta[:, 2]
    half = 0.5 * turn
    scale = np.sinc(half / np.pi)  # V(φ) = sinc(φ/2) Rot(φ/2)
    z = delta[:, 3:].reshape(draws, -1, 2) - delta[:, None, :2]
    relative = m.positions - m.pose[:2] + turned_by(half, z) * scale[:, None, None]
    return turned_by(-m.pose[2] - turn, relative).reshape(draws, -1)


def turned_by(angles: Array, vectors: Array) -> Array:
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


@pytest.mark.parametrize("seed", range(3))
def test_a_poor_heading_bends_what_is_predicted_as_drawing_from_the_filter_does(seed: int) -> None:
    """σ of 12° of heading: the linear prediction is off by centimetres and too sure along the line of sight."""
    rng = np.random.default_rng(seed)
    m = StochasticMap(MapSpec(unconfirmed_age=None), [1.0, 2.0, 0.5], np.diag([0.05, 0.05, 0.02]) ** 2)
    m.add(Scan.from_points(rng.uniform(-6.0, 6.0, (4, 2)), sigma=0.05), np.arange(4))
    m.predict(Odometry.from_motion([0.5, 0.0, 0.3], [0.1, 0.05, 0.2]))
    drawn = drawn_from(m, 400_000, rng).reshape(-1, 4, 2)
    far = int(np.argmax(np.hypot(*(m.positions - m.pose[:2]).T)))
    sight = drawn[:, far].mean(axis=0)
    sight /= np.hypot(*sight)
    variance = np.var(drawn[:, far] @ sight)
    off, along = {}, {}
    for name, second_order in (("bent", True), ("linear", False)):
        m.spec = MapSpec(unconfirmed_age=None, second_order=second_order)
        prediction = predicted(m, math.inf)
        off[name] = np.abs(prediction.positions - drawn.mean(axis=0)).max()
        along[name] = sight @ prediction.covariances[far] @ sight
    assert off["linear"] > 0.05 and off["bent"] < 0.1 * off["linear"]
    assert 0.9 < along["bent"] / variance < 1.1 and along["linear"] / variance < 0.8


def test_what_is_turned_as_a_whole_is_not_bent() -> None:
    """The first pose's heading is unknown by 20°: features seen from there turn with it, and are predicted as well."""
    spec = MapSpec(unconfirmed_age=None)
    m = StochasticMap(spec, np.zeros(3), np.diag([0.0, 0.0, 0.35]) ** 2)
    scan = Scan.from_points([[5.0, 1.0], [2.0, -4.0]], sigma=0.03)
    m.add(scan, np.arange(2))
    prediction = predicted(m, math.inf)
    np.testing.assert_allclose(prediction.positions, scan.points, atol=1e-12)
    np.testing.assert_allclose(prediction.covariances, (1.0 + 0.25 * 0.35**2) * scan.covariances, atol=1e-12)


def test_gates_hold_what_they_claim_with_a_poor_heading() -> None:
    """The true pairing is outside of the .99 gates of one and of all six together in one case of a hundred."""
    rng, outside = np.random.default_rng(4), {}
    for name, second_order in (("bent", True), ("linear", False)):
        missed, runs = np.zeros(2), 3000
        spec = MapSpec(unconfirmed_age=None, second_order=second_order)
        for _ in range(runs):
            m = StochasticMap(spec)
            m.add(Scan.from_points(rng.uniform(-6.0, 6.0, (6, 2)), sigma=0.02), np.arange(6))
            m.predict(Odometry.from_motion([0.1, 0.0, 0.2], [0.05, 0.03, 0.13]))
            z = drawn_from(m, 1, rng)[0] + 0.04 * rng.standard_normal(12)
            prediction = predicted(m, math.inf)
            nu, S = z - prediction.positions.ravel(), prediction.joint(np.arange(6)) + 0.04**2 * np.eye(12)
            missed += nu[:2] @ np.linalg.solve(S[:2, :2], nu[:2]) > 9.210, nu @ np.linalg.solve(S, nu) > 26.217
        outside[name] = missed / runs
    assert np.all(outside["bent"] < 0.03)
    assert outside["linear"][0] > 0.03 and outside["linear"][1] > 0.10
