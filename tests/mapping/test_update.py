"""The joint update: iterated to the optimum, cheap where it is linear, consistent where headings are poor."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares

from slam_gym.geometry import observe, transform, wrap_angle
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.mapping.update import update
from slam_gym.metrics.consistency import pose_nees
from slam_gym.types import UNPAIRED, Array, Odometry, Scan
from tests.mapping.small_maps import KEEP, STILL, landmarks, mapped
from tests.oracles.geometry import block_diagonal, rigid_motions
from tests.oracles.map import SIGMA, KnownAssociation, Step, make_scan, random_covariances, wander
from tests.oracles.statistics import anees_interval, for_seeds

INVARIANT = MapSpec(unconfirmed_age=None)
ORDINARY = MapSpec(right_invariant=False, unconfirmed_age=None)


# --- the iterated update: the optimum of prior and measurements together ---------------------------------------------

NOISE = 0.05  # [m]


def poor_heading(seed: int, heading: float = 0.1) -> tuple[StochasticMap, Scan, np.ndarray]:
    """A map of eight features, its robot's heading poorly known, and a scan of four of them and a stranger."""
    rng = np.random.default_rng(seed)
    m = StochasticMap(ORDINARY, [1.0, 2.0, 0.5], np.diag([0.05, 0.05, 0.02]) ** 2)
    bearing, distance = rng.uniform(-np.pi, np.pi, 8), rng.uniform(2.0, 6.0, 8)
    m.add(Scan.from_polar(distance, bearing, NOISE, 0.01), np.arange(8))
    m.predict(Odometry.from_motion([0.5, 0.0, 0.3], [0.1, 0.05, heading]))
    drawn = m.mean + np.linalg.cholesky(m.covariance + 1e-12 * np.eye(19)) @ rng.standard_normal(19)
    features = np.array([0, 3, UNPAIRED, 5, 7])
    points = observe(drawn[:3], drawn[3:].reshape(-1, 2)[[0, 3, 0, 5, 7]]) + NOISE * rng.standard_normal((5, 2))
    points[2] = 9.0
    return m, Scan.from_points(points, sigma=NOISE), features


def iterate(m: StochasticMap, scan: Scan, features: np.ndarray, passes: int, settled: float = 0.0) -> None:
    """Update by at most so many passes of the ordinary filter, until another would move less than `settled` σ."""
    x, P, *_ = m.arrays
    update(x, P, m.n, (scan.points, scan.covariances), features, (passes, settled), False)


def optimum(m: StochasticMap, scan: Scan, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The state of least cost, by a general solver, and the covariance of the linearisation there."""
    prior, root = m.mean, np.linalg.cholesky(np.linalg.inv(m.covariance)).T
    paired = features != UNPAIRED

    def residuals(x: np.ndarray) -> np.ndarray:
        expected = observe(x[:3], x[3:].reshape(-1, 2)[features[paired]])
        return np.concatenate([root @ (x - prior), ((scan.points[paired] - expected) / NOISE).ravel()])

    found = least_squares(residuals, prior, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return found.x, np.linalg.inv(found.jac.T @ found.jac)


@for_seeds(12)
def test_iterated_to_the_end_it_is_the_least_squares_optimum(seed: int) -> None:
    m, scan, features = poor_heading(seed)
    mean, covariance = optimum(m, scan, features)
    iterate(m, scan, features, passes=30)
    np.testing.assert_allclose(m.mean, mean, atol=2e-5)
    np.testing.assert_allclose(m.covariance, covariance, atol=2e-6)


@pytest.mark.parametrize("settled", [0.1, 0.3, 1.0])
def test_a_pass_is_spared_only_where_it_would_hardly_move_the_state(settled: float) -> None:
    """In units of the σ of the state: Mahalanobis distance to the optimum, over headings known well and poorly."""
    spared = 0
    for seed in range(60):
        heading = 10.0 ** np.random.default_rng(seed).uniform(-3.0, -0.5)
        m, scan, features = poor_heading(seed, heading)
        mean, covariance = optimum(m, scan, features)
        once = m.copy()
        iterate(m, scan, features, 30, settled)
        iterate(once, scan, features, 1)
        spared += np.array_equal(m.mean, once.mean)
        off = m.mean - mean
        assert np.sqrt(off @ np.linalg.solve(covariance, off)) < 1.3 * settled
    assert 0 < spared < 60


def test_with_wheels_that_turn_badly_the_iterated_filter_alone_is_consistent() -> None:
    """σ of 8° of heading a step, in a map begun from a known pose: mean NEES of the pose at the end of 40 runs."""
    runs, world, mean = 40, landmarks(np.random.default_rng(12), 12), {}
    for name, spec in (("iterated", ORDINARY), ("one pass", KEEP)):
        total = 0.0
        for seed in range(runs):
            known, rng = KnownAssociation(StochasticMap(spec)), np.random.default_rng([31, seed])
            noise = random_covariances(rng, SIGMA, len(world))
            points = world + np.array([rng.multivariate_normal([0.0, 0.0], R) for R in noise])
            known.step(Step(STILL, make_scan(points, noise), np.arange(len(world)), np.zeros(3)))
            for step in wander(rng, 40, world, q=np.diag([0.05, 0.03, 0.14]) ** 2):
                known.step(step)
            total += pose_nees(known.map.pose, known.map.pose_covariance, step.pose) / 3.0
        mean[name] = total / runs
    low, high = anees_interval(runs, 3, 0.99)
    assert low < mean["iterated"] < high
    assert mean["one pass"] > 1.5 * high


# --- the right-invariant error ---------------------------------------------------------------------------------------


def unobservable(x: Array) -> Array:
    """(d, 3) what no measurement can tell: where the whole lies in B, and how it is turned about the origin."""
    places = np.delete(x, 2).reshape(-1, 2)
    return np.insert(rigid_motions(places), 2, [0.0, 0.0, 1.0], axis=0)


def information(m: StochasticMap) -> Array:
    """Nᵀ P⁻¹ N, (3, 3): what the filter believes to know of the unobservable."""
    N = unobservable(m.mean)
    return N.T @ np.linalg.solve(m.covariance, N)


@pytest.mark.parametrize("seed", range(5))
def test_where_the_whole_lies_stays_as_unknown_as_it_was(seed: int) -> None:
    """The robot's first pose in B is hardly known, and from the first look on nothing may tell more of it."""
    worlds, kept = landmarks(np.random.default_rng(seed), 15), {}
    for name, spec in (("invariant", INVARIANT), ("ordinary", ORDINARY)):
        known = KnownAssociation(StochasticMap(spec, np.zeros(3), np.diag([1.0, 1.0, 0.3]) ** 2))
        steps = wander(np.random.default_rng([seed, 1]), 60, worlds, q=np.diag([0.05, 0.03, 0.05]) ** 2)
        known.step(next(steps))
        before = information(known.map)
        for step in steps:
            known.step(step)
        kept[name] = information(known.map) - before
    gained = np.linalg.eigvalsh(kept["invariant"])  # a little is lost: the first look ties the map to B but loosely
    assert -1e-3 * before[2, 2] < gained[0] and gained[2] < 1e-8
    assert kept["ordinary"][2, 2] > 0.1 * before[2, 2]


@pytest.mark.parametrize("seed", range(4))
def test_the_whole_moved_and_turned_is_estimated_moved_and_turned(seed: int) -> None:
    """Invariance: another frame B changes nothing but the frame, however large the corrections."""
    move = np.array([7.0, -3.0, 2.0])
    there, here = (StochasticMap(INVARIANT, pose) for pose in (move, np.zeros(3)))
    both = [KnownAssociation(m) for m in (here, there)]
    rng = np.random.default_rng(seed)
    for step in wander(rng, 30, landmarks(rng, 12), q=np.diag([0.05, 0.03, 0.14]) ** 2):
        for one in both:
            one.step(step)
    np.testing.assert_allclose(there.pose[:2], transform(move, here.pose[None, :2])[0], atol=1e-8)
    np.testing.assert_allclose(wrap_angle(there.pose[2] - here.pose[2] - move[2]), 0.0, atol=1e-9)
    np.testing.assert_allclose(there.positions, transform(move, here.positions), atol=1e-8)
    C = np.kron(np.eye(here.n), [[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]])
    np.testing.assert_allclose(there.covariance[3:, 3:], C @ here.covariance[3:, 3:] @ C.T, rtol=0, atol=1e-9)


def test_one_update_is_that_of_the_textbook_in_the_coordinates_of_the_group() -> None:
    """ξ = T⁻¹ δ with δF = ξ_F + J F ξ_θ: there H = Cᵀ[−I 0 I], x⁺ = exp(K ν) x, and P⁺ comes back with T(x⁺)."""
    m, _, _ = mapped(INVARIANT, steps=20)
    m = StochasticMap.of_state(replace(INVARIANT, iterations=1), m.state)
    rng, x, P = np.random.default_rng(2), m.mean, m.covariance
    features = np.array([0, 2, 5])
    points = observe(x[:3], x[3:].reshape(-1, 2)[features]) + rng.normal(0, 0.2, (3, 2))
    scan = make_scan(points, random_covariances(rng, SIGMA, 3))
    c, s = np.cos(x[2]), np.sin(x[2])
    H = np.zeros((6, len(x)))
    for i, f in enumerate(3 + 2 * features):
        H[2 * i : 2 * i + 2, :2] = -np.array([[c, s], [-s, c]])
        H[2 * i : 2 * i + 2, f : f + 2] = [[c, s], [-s, c]]
    T, R = to_ordinary(x), block_diagonal(scan.covariances)
    Q = np.linalg.solve(T, np.linalg.solve(T, P).T).T
    K = Q @ H.T @ np.linalg.inv(H @ Q @ H.T + R)
    xi = K @ (points - observe(x[:3], x[3:].reshape(-1, 2)[features])).ravel()
    after = (np.eye(len(x)) - K @ H) @ Q
    expected = along_group(x, xi)
    m.update(scan, features)
    np.testing.assert_allclose(m.mean, expected, atol=1e-9)
    np.testing.assert_allclose(m.covariance, to_ordinary(expected) @ after @ to_ordinary(expected).T, atol=1e-9)


def to_ordinary(x: Array) -> Array:
    """T: from the error of the group to the ordinary one."""
    T = np.eye(len(x))
    T[:, 2] = unobservable(x)[:, 2]
    return T


def along_group(x: Array, xi: Array) -> Array:
    """exp(ξ) x by the exponential of the matrix of the group, robot and features its translations."""
    places = [0, *range(3, len(x), 2)]
    A, X = np.zeros((2 + len(places),) * 2), np.eye(2 + len(places))
    A[:2, :2] = [[0.0, -xi[2]], [xi[2], 0.0]]
    for k, j in enumerate(places):
        A[:2, 2 + k], X[:2, 2 + k] = xi[j : j + 2], x[j : j + 2]
    moved, out = expm(A) @ X, x.copy()
    for k, j in enumerate(places):
        out[j : j + 2] = moved[:2, 2 + k]
    out[2] = wrap_angle(x[2] + xi[2])
    return out


def after_a_turn(iterations: int, seed: int) -> float:
    """NEES of the pose of a robot whose heading had a σ of 0.6 rad before it saw twelve mapped features again."""
    rng, sigma, prior = np.random.default_rng([7, seed]), 0.03, np.array([0.1, 0.1, 0.6])
    places, R = rng.uniform(-6.0, 6.0, (12, 2)), np.tile(sigma**2 * np.eye(2), (12, 1, 1))
    m, pose = StochasticMap(MapSpec(iterations=iterations)), prior * rng.normal(size=3)
    m.add(make_scan(places + sigma * rng.normal(size=(12, 2)), R), np.arange(12))
    m.place(np.zeros(3), np.diag(prior**2))
    m.update(make_scan(observe(pose, places) + sigma * rng.normal(size=(12, 2)), R), np.arange(12))
    return pose_nees(m.pose, m.pose_covariance, pose) / 3.0


def test_a_robot_that_has_turned_unnoticed_is_consistent_once_the_update_has_settled() -> None:
    settled, cut = (np.mean([after_a_turn(passes, seed) for seed in range(200)]) for passes in (10, 3))
    assert 0.85 < settled < 1.2 and cut > 10.0
    assert MapSpec().iterations == 10


def test_round_a_loop_it_is_consistent_where_the_ordinary_error_is_not() -> None:
    """Two laps of ten metres' radius with 3° of heading a step: mean NEES of the pose at the end of 30 runs."""
    angles = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    ring = np.array([0.0, 10.0]) + np.concatenate(
        [r * np.column_stack([np.cos(angles), np.sin(angles)]) for r in (9, 11)]
    )
    mean = {}
    for name, spec in (("invariant", INVARIANT), ("ordinary", ORDINARY)):
        total = 0.0
        for seed in range(30):
            known = KnownAssociation(StochasticMap(spec))
            q = np.diag([0.02, 0.02, 0.05]) ** 2
            for step in wander(np.random.default_rng([5, seed]), 250, ring, reach=3.0, turn=0.03, q=q):
                known.step(step)
            total += pose_nees(known.map.pose, known.map.pose_covariance, step.pose) / 3.0
        mean[name] = total / 30
    low, high = anees_interval(30, 3, 0.99)
    assert low < mean["invariant"] < high
    assert mean["ordinary"] > 1.5 * mean["invariant"]
