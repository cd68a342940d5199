"""The stochastic map against a textbook EKF, finite differences, and the laws an estimator keeps."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from slam_gym.geometry import compose, observe, wrap_angle
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import UNKNOWN_KIND, UNPAIRED, Array, Odometry, Scan
from tests.oracles.map import SIGMA, KnownAssociation, Q, Step, TextbookMap, make_scan, random_covariance, wander

KEEP = MapSpec(unconfirmed_age=None)
FEJ = MapSpec(first_estimate_jacobians=True, unconfirmed_age=None)
START = np.array([1.0, -2.0, 3.0])
START_COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.03, -0.001], [0.002, -0.001, 0.01]])
STILL = Odometry(np.zeros(3), np.zeros((3, 3)))


def landmarks(rng: np.random.Generator, n: int = 25) -> Array:
    return rng.uniform([-4.0, -2.0], [5.0, 7.0], (n, 2))


def mapped(spec: MapSpec = KEEP, steps: int = 30, seed: int = 0) -> tuple[StochasticMap, TextbookMap, list[int]]:
    """A map that has seen a random world for a while, with its textbook twin and the landmark behind each feature."""
    rng = np.random.default_rng(seed)
    twins = KnownAssociation(
        StochasticMap(spec, START, START_COVARIANCE, capacity=2),
        TextbookMap(START, START_COVARIANCE, spec.first_estimate_jacobians),
    )
    for step in wander(rng, steps, landmarks(rng)):
        twins.step(step)
    assert twins.textbook is not None
    return twins.map, twins.textbook, twins.sources


def numerical(f, x: Array, wrapped: int | None = None, step: float = 1e-6) -> Array:
    """Jacobian of f at x by central differences; `wrapped` names the row that is an angle."""
    columns = []
    for i in range(len(x)):
        e = np.zeros(len(x))
        e[i] = step
        difference = f(x + e) - f(x - e)
        if wrapped is not None:
            difference[wrapped] = wrap_angle(difference[wrapped])
        columns.append(difference / (2.0 * step))
    return np.column_stack(columns)


def h(x: Array, features: Array) -> Array:
    return observe(x[:3], x[3:].reshape(-1, 2)[features]).ravel()


# --- against the textbook ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", [KEEP, FEJ], ids=["EKF", "FEJ"])
def test_equals_textbook_ekf_through_growth_and_removal(spec: MapSpec) -> None:
    rng = np.random.default_rng(3)
    twins = KnownAssociation(
        StochasticMap(spec, START, START_COVARIANCE, capacity=1),
        TextbookMap(START, START_COVARIANCE, spec.first_estimate_jacobians),
    )
    for number, step in enumerate(wander(rng, 120, landmarks(rng, 40), reach=4.0)):
        twins.step(step)
        if number % 20 == 19:
            gone = np.sort(rng.choice(twins.map.n, 3, replace=False))
            kept = twins.map.remove(gone)
            twins.textbook.remove(gone)
            twins.sources = [twins.sources[j] for j in kept]
        np.testing.assert_allclose(twins.map.mean, twins.textbook.x, rtol=0, atol=1e-9)
        np.testing.assert_allclose(twins.map.covariance, twins.textbook.P, rtol=0, atol=1e-10)
    assert twins.map.n > 20


@pytest.mark.parametrize("spec", [KEEP, FEJ], ids=["EKF", "FEJ"])
def test_joint_update_with_one_feature_paired_twice(spec: MapSpec) -> None:
    m, textbook, _ = mapped(spec)
    rng = np.random.default_rng(1)
    features = np.array([4, UNPAIRED, 4, 1, UNPAIRED])
    points = h(m.mean, np.maximum(features, 0)).reshape(-1, 2) + rng.normal(0, 0.03, (5, 2))
    scan = make_scan(points, np.array([random_covariance(rng, SIGMA) for _ in features]))
    m.update(scan, features)
    textbook.update(scan, features)
    np.testing.assert_allclose(m.mean, textbook.x, rtol=0, atol=1e-10)
    np.testing.assert_allclose(m.covariance, textbook.P, rtol=0, atol=1e-11)


def test_one_measurement_by_hand() -> None:
    """Robot known exactly at the origin, feature at (2, 0) ± .3: the scalar Kalman formulae in x and y."""
    m = StochasticMap()
    m.add(make_scan(np.array([[2.0, 0.0]]), np.array([np.eye(2) * 0.09])), np.array([0]))
    m.update(make_scan(np.array([[2.2, -0.1]]), np.array([np.diag([0.01, 0.09])])), np.array([0]))
    np.testing.assert_allclose(m.positions, [[2.0 + 0.9 * 0.2, -0.05]], atol=1e-12)
    np.testing.assert_allclose(m.covariances, [np.diag([0.009, 0.045])], atol=1e-12)
    np.testing.assert_array_equal(m.pose, np.zeros(3))


# --- Jacobians against finite differences -----------------------------------------------------------------------------


def test_prediction_is_first_order_propagation_of_h() -> None:
    m, _, _ = mapped()
    prediction = m.prediction(100.0)
    assert len(prediction) == m.n
    H = numerical(lambda x: h(x, prediction.features), m.mean)
    expected = H @ m.covariance @ H.T
    np.testing.assert_allclose(prediction.positions.ravel(), h(m.mean, prediction.features), atol=1e-12)
    joint = prediction.joint(np.arange(m.n))
    np.testing.assert_allclose(joint, expected, rtol=0, atol=1e-9)
    for j, marginal in enumerate(prediction.covariances):
        np.testing.assert_allclose(marginal, expected[2 * j : 2 * j + 2, 2 * j : 2 * j + 2], rtol=0, atol=1e-9)


def test_odometry_is_propagated_to_first_order() -> None:
    m, _, _ = mapped()
    odometry = Odometry(np.array([0.4, -0.1, 0.3]), START_COVARIANCE)
    before, P = m.mean, m.covariance
    F = numerical(lambda x: np.concatenate([compose(x[:3], odometry.motion), x[3:]]), before, wrapped=2)
    G = np.vstack(
        [numerical(lambda u: compose(before[:3], u), odometry.motion, wrapped=2), np.zeros((len(before) - 3, 3))]
    )
    m.predict(odometry)
    np.testing.assert_allclose(m.pose, compose(before[:3], odometry.motion), atol=1e-14)
    np.testing.assert_allclose(m.covariance, F @ P @ F.T + G @ odometry.covariance @ G.T, rtol=0, atol=1e-9)


def test_new_features_are_propagated_to_first_order() -> None:
    m, _, _ = mapped()
    rng = np.random.default_rng(5)
    points, R = rng.uniform(-4, 4, (2, 2)), np.array([random_covariance(rng, SIGMA) for _ in range(2)])
    before, P = m.mean, m.covariance

    def appended(xz: Array) -> Array:
        x, z = xz[: len(before)], xz[len(before) :].reshape(2, 2)
        pairs = [compose(x[:3], np.append(point, 0.0))[:2] for point in z]
        return np.concatenate([x, *pairs])

    J = numerical(appended, np.concatenate([before, points.ravel()]))
    noise = np.zeros((len(before) + 4, len(before) + 4))
    noise[: len(before), : len(before)] = P
    for i in range(2):
        noise[len(before) + 2 * i :, len(before) + 2 * i :][:2, :2] = R[i]
    np.testing.assert_array_equal(m.add(make_scan(points, R), np.array([0, 1])), [m.n - 2, m.n - 1])
    np.testing.assert_allclose(m.mean, appended(np.concatenate([before, points.ravel()])), atol=1e-14)
    np.testing.assert_allclose(m.covariance, J @ noise @ J.T, rtol=0, atol=1e-8)


# --- laws -------------------------------------------------------------------------------------------------------------


def smallest_over_largest(m: StochasticMap) -> float:
    assert np.array_equal(m.covariance, m.covariance.T)
    eigenvalues = np.linalg.eigvalsh(m.covariance)
    return float(eigenvalues[0] / eigenvalues[-1])


@pytest.mark.parametrize(
    ("spec", "nonsense"), [(KEEP, False), (KEEP, True), (FEJ, False)], ids=["EKF", "EKF fed nonsense", "FEJ"]
)
def test_stays_symmetric_and_psd_over_thousands_of_random_steps(spec: MapSpec, nonsense: bool) -> None:
    """Noises of very different sizes (some of them singular), random pairings, growth and removal.

    Measurements agree with the estimate up to their noise, or have nothing to do with it.
    """
    rng = np.random.default_rng(8)
    m, worst = StochasticMap(spec, capacity=1), np.inf
    for number in range(4000):
        sigma = 10.0 ** rng.uniform(-4, 0, 3) * rng.integers(0, 2, 3)
        m.predict(Odometry(rng.normal(0, 0.3, 3), np.diag(sigma**2)))
        features, scale = rng.integers(UNPAIRED, m.n, rng.integers(0, 8)), 10.0 ** rng.uniform(-3, 0)
        points = rng.uniform(-5, 5, (len(features), 2))
        if m.n and not nonsense:
            expected = h(m.mean, np.maximum(features, 0)).reshape(-1, 2) + rng.normal(0, scale, points.shape)
            points = np.where(features[:, None] == UNPAIRED, points, expected)
        scan = make_scan(points, np.array([random_covariance(rng, scale) for _ in features]).reshape(-1, 2, 2))
        m.update(scan, features)
        m.add(scan, np.flatnonzero(features == UNPAIRED)[: 40 - m.n])
        if rng.random() < 0.1 and m.n:
            m.remove(rng.choice(m.n, rng.integers(0, m.n), replace=False))
        m.end_of_step()
        if number % 20 == 0 and m.n:
            worst = min(worst, smallest_over_largest(m))
    assert np.all(np.isfinite(m.mean)) and worst >= -1e-9


@pytest.mark.parametrize("lost", [10.0, 1e4, 1e7])
def test_stays_psd_when_a_loop_closure_collapses_a_huge_uncertainty(lost: float) -> None:
    rng = np.random.default_rng(2)
    points, R = rng.uniform(-5, 5, (20, 2)), np.tile(1e-4 * np.eye(2), (20, 1, 1))
    m, scan = StochasticMap(KEEP), make_scan(points, R)
    m.add(scan, np.arange(10))
    m.predict(Odometry(np.zeros(3), np.diag([lost**2, lost**2, 1e-2])))
    m.add(scan, np.arange(10, 20))
    before = m.covariance[0, 0]
    for _ in range(30):
        m.update(make_scan(points[:10], R[:10]), np.arange(10))
        assert smallest_over_largest(m) >= -1e-9
        m.predict(Odometry(np.zeros(3), np.diag([1e-4, 1e-4, 1e-6])))
    assert m.covariance[0, 0] < 1e-5 * before


def test_update_never_raises_uncertainty() -> None:
    m, _, _ = mapped()
    before = m.covariance
    scan = make_scan(h(m.mean, np.arange(3)).reshape(-1, 2), np.tile(1e-2 * np.eye(2), (3, 1, 1)))
    m.update(scan, np.arange(3))
    assert np.linalg.eigvalsh(before - m.covariance)[0] > -1e-12


def test_order_of_features_does_not_matter() -> None:
    """The same measurements, features added in another order: the same estimate, permuted."""
    rng = np.random.default_rng(4)
    steps = list(wander(rng, 25, landmarks(rng)))
    order = np.argsort(rng.random(25))

    def shuffled(step: Step) -> Step:
        by = np.argsort(order[step.sources])
        return replace(step, scan=make_scan(step.scan.points[by], step.scan.covariances[by]), sources=step.sources[by])

    one, other = KnownAssociation(StochasticMap(KEEP)), KnownAssociation(StochasticMap(KEEP))
    for step in steps:
        one.step(step)
        other.step(shuffled(step))
    place = [other.sources.index(source) for source in one.sources]
    rows = np.concatenate([[0, 1, 2], *([3 + 2 * j, 4 + 2 * j] for j in place)])
    assert one.sources != other.sources
    np.testing.assert_allclose(one.map.mean, other.map.mean[rows], rtol=0, atol=1e-10)
    np.testing.assert_allclose(one.map.covariance, other.map.covariance[np.ix_(rows, rows)], rtol=0, atol=1e-11)


def test_removal_is_marginalisation() -> None:
    m, _, _ = mapped()
    before, gone = m.copy(), np.array([7, 0, 3])
    kept = m.remove(gone)
    np.testing.assert_array_equal(kept, np.setdiff1d(np.arange(before.n), gone))
    rows = np.concatenate([[0, 1, 2], *([3 + 2 * j, 4 + 2 * j] for j in kept)])
    np.testing.assert_array_equal(m.mean, before.mean[rows])
    np.testing.assert_array_equal(m.covariance, before.covariance[np.ix_(rows, rows)])
    for name in ("ids", "seen", "first_seen", "last_seen", "sizes", "size_variances"):
        np.testing.assert_array_equal(getattr(m, name), getattr(before, name)[kept])
    np.testing.assert_array_equal(m.remove(np.arange(m.n)), [])
    assert m.n == 0 and len(m.prediction(10.0)) == 0


def test_capacity_changes_nothing() -> None:
    rng = np.random.default_rng(6)
    steps = list(wander(rng, 20, landmarks(rng)))
    small, large = (KnownAssociation(StochasticMap(KEEP, capacity=c)) for c in (1, 500))
    for step in steps:
        small.step(step)
        large.step(step)
    np.testing.assert_array_equal(small.map.mean, large.map.mean)
    np.testing.assert_array_equal(small.map.covariance, large.map.covariance)


@pytest.mark.parametrize("spec", [KEEP, FEJ], ids=["EKF", "FEJ"])
@pytest.mark.parametrize("duplicate", [StochasticMap.copy, copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_copies_go_their_own_way(spec: MapSpec, duplicate) -> None:
    m, _, _ = mapped(spec, steps=5)
    other, mean, covariance = duplicate(m), m.mean, m.covariance
    rng = np.random.default_rng(0)
    scan = make_scan(h(m.mean, np.arange(3)).reshape(-1, 2) + 0.05, np.array([random_covariance(rng, 0.1)] * 3))
    for either in (other, m):
        either.predict(Odometry(np.array([0.1, 0.0, 0.1]), Q))
        either.update(scan, np.arange(3))
        either.add(scan, np.array([1]))
        if either is other:
            np.testing.assert_array_equal(m.mean, mean)
            np.testing.assert_array_equal(m.covariance, covariance)
    np.testing.assert_array_equal(m.mean, other.mean)
    np.testing.assert_array_equal(m.covariance, other.covariance)


# --- consistency ------------------------------------------------------------------------------------------------------


def test_nees_lies_in_its_chi_square_interval() -> None:
    """Known associations, moderate heading noise: the mean NEES of 60 runs, of the pose and of the whole state."""
    runs, world = 60, landmarks(np.random.default_rng(12), 12)
    pose_nees, state_nees, dimensions = 0.0, 0.0, 0
    for seed in range(runs):
        rng = np.random.default_rng([17, seed])
        known = KnownAssociation(StochasticMap(KEEP))
        for step in wander(rng, 40, world, q=np.diag([0.01, 0.01, 0.004]) ** 2):
            known.step(step)
        m = known.map
        error = m.mean - np.concatenate([step.pose, world[known.sources].ravel()])
        error[2] = wrap_angle(error[2])
        pose_nees += error[:3] @ np.linalg.solve(m.pose_covariance, error[:3])
        state_nees += error @ np.linalg.solve(m.covariance, error)
        dimensions += len(error)
    low, high = chi2.ppf([0.005, 0.995], 3 * runs)
    assert low < pose_nees < high
    low, high = chi2.ppf([0.005, 0.995], dimensions)
    assert low < state_nees < high


def test_first_estimate_jacobians_gain_no_heading_from_looking_around() -> None:
    """Heading relative to B is unobservable: an uncertainty of it at the start must survive, whatever is measured.

    A standard EKF loses it, since its Jacobians are taken at estimates that move (Huang et al. 2010).
    """
    sigma, final = 0.1, {}
    for name, spec in (("EKF", KEEP), ("FEJ", FEJ)):
        rng = np.random.default_rng(21)
        known = KnownAssociation(StochasticMap(spec, np.zeros(3), np.diag([0.0, 0.0, sigma**2])))
        for step in wander(rng, 150, landmarks(rng), q=np.diag([0.05, 0.05, 0.05]) ** 2):
            known.step(step)
        final[name] = np.sqrt(known.map.pose_covariance[2, 2])
    assert final["FEJ"] >= sigma * (1.0 - 1e-9)
    assert final["EKF"] < 0.95 * sigma


# --- what is predicted ------------------------------------------------------------------------------------------------


def test_reach_is_widened_by_three_sigma() -> None:
    m = StochasticMap()
    points = np.array([[4.9, 0.0], [5.2, 0.0], [0.0, 5.2], [-5.2, 0.0], [20.0, 0.0]])
    R = np.array([np.eye(2) * 0.01**2, np.eye(2) * 0.05**2, np.diag([0.01, 0.1]) ** 2, *[np.eye(2) * 0.08**2] * 2])
    m.add(make_scan(points, R), np.arange(5))
    prediction = m.prediction(5.0)
    np.testing.assert_array_equal(prediction.features, [0, 2, 3])
    np.testing.assert_allclose(prediction.positions, points[[0, 2, 3]])
    np.testing.assert_allclose(prediction.covariances, R[[0, 2, 3]])


def test_joint_of_any_rows_in_any_order() -> None:
    m, _, _ = mapped(FEJ)
    prediction = m.prediction(100.0)
    whole = prediction.joint(np.arange(len(prediction)))
    rows = np.array([6, 0, 6, 3])
    entries = np.column_stack([2 * rows, 2 * rows + 1]).ravel()
    np.testing.assert_allclose(prediction.joint(rows), whole[np.ix_(entries, entries)], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(whole, whole.T)


def test_localities_are_those_of_the_graph_and_near_is_what_is_local_to_recent_features() -> None:
    m, _, _ = mapped()
    graph = CovisibilityGraph()
    graph.add(m.n)
    graph.see_together(np.array([0, 1]))
    prediction = m.prediction(100.0, graph, np.array([1]))
    np.testing.assert_array_equal(prediction.near, np.arange(m.n) < 2)
    rows = np.array([2, 1, 0])
    np.testing.assert_array_equal(prediction.local(rows), graph.among(rows))
    without = m.prediction(100.0)
    assert without.local is None and without.near.all()


@pytest.mark.parametrize("change", ["predict", "update", "add", "remove"])
def test_an_outdated_prediction_says_so(change: str) -> None:
    m, _, _ = mapped()
    prediction = m.prediction(100.0)
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


# --- bookkeeping ------------------------------------------------------------------------------------------------------


def look(m: StochasticMap, *features: int) -> None:
    """Measure some features exactly where they are predicted, then end the step."""
    rows = np.array(features, dtype=np.int64)
    m.update(make_scan(h(m.mean, rows).reshape(-1, 2), np.tile(np.eye(2), (len(rows), 1, 1))), rows)
    m.end_of_step()


def fresh(m: StochasticMap, count: int) -> None:
    m.add(make_scan(np.ones((count, 2)), np.tile(np.eye(2), (count, 1, 1))), np.arange(count))


def test_counts_the_steps_in_which_a_feature_was_seen() -> None:
    m = StochasticMap()
    fresh(m, 3)
    look(m, 0)
    np.testing.assert_array_equal(m.seen, [1, 1, 1])  # the step that added it
    look(m, 1, 1)
    look(m, 1, 2)
    np.testing.assert_array_equal(m.seen, [1, 3, 2])
    np.testing.assert_array_equal(m.first_seen, [0, 0, 0])
    np.testing.assert_array_equal(m.last_seen, [0, 2, 2])
    np.testing.assert_array_equal(m.provisional, [True, False, False])
    assert m.step == 3


def test_maintenance_names_features_seen_once_more_than_two_steps_ago() -> None:
    m = StochasticMap()
    look(m)
    fresh(m, 3)  # in step 1
    look(m)
    look(m, 1)
    fresh(m, 1)  # in step 3
    np.testing.assert_array_equal(m.unconfirmed(), [])
    look(m)
    np.testing.assert_array_equal(m.unconfirmed(), [0, 2])
    m.remove(m.unconfirmed())
    np.testing.assert_array_equal(m.ids, [1, 3])
    fresh(m, 1)
    np.testing.assert_array_equal(m.ids, [1, 3, 4])  # an id is never given twice


def test_without_an_age_limit_nothing_is_unconfirmed() -> None:
    m = StochasticMap(KEEP)
    fresh(m, 2)
    for _ in range(10):
        m.end_of_step()
    assert len(m.unconfirmed()) == 0


def test_sizes_are_averaged_by_their_variances() -> None:
    m, R = StochasticMap(), np.tile(np.eye(2), (3, 1, 1))
    points = np.ones((3, 2))
    m.add(make_scan(points, R, np.array([0.5, np.nan, 0.7]), np.array([0.01, np.nan, 0.01])), np.arange(3))
    measured = make_scan(points, R, np.array([0.8, 0.3, np.nan]), np.array([0.02, 0.04, np.nan]))
    m.update(measured, np.arange(3))
    np.testing.assert_allclose(m.sizes, [0.6, 0.3, 0.7])
    np.testing.assert_allclose(m.size_variances, [0.01 * 0.02 / 0.03, 0.04, 0.01])


def test_what_is_handed_out_is_no_window_into_the_map() -> None:
    m, _, _ = mapped()
    before = m.mean, m.covariance, m.sizes, m.ids
    names = ("pose", "pose_covariance", "positions", "covariances", "mean", "covariance", "ids", "seen", "sizes")
    for name in (*names, "first_seen", "last_seen", "size_variances", "provisional"):
        getattr(m, name)[...] = 0
    m.prediction(100.0).positions[...] = 0.0
    for old, new in zip(before, (m.mean, m.covariance, m.sizes, m.ids)):
        np.testing.assert_array_equal(old, new)


# --- what is refused --------------------------------------------------------------------------------------------------


def scan_with(points: Array | None = None, covariances: Array | None = None) -> Scan:
    return make_scan(
        np.ones((2, 2)) if points is None else points,
        np.tile(np.eye(2), (2, 1, 1)) if covariances is None else covariances,
    )


BAD_SCANS = {
    "NaN point": scan_with(points=np.array([[1.0, 1.0], [1.0, np.nan]])),
    "infinite point": scan_with(points=np.array([[1.0, 1.0], [np.inf, 1.0]])),
    "NaN covariance": scan_with(covariances=np.array([np.eye(2), [[1.0, np.nan], [np.nan, 1.0]]])),
    "indefinite": scan_with(covariances=np.array([np.eye(2), [[1.0, 2.0], [2.0, 1.0]]])),
    "negative": scan_with(covariances=np.array([np.eye(2), -np.eye(2)])),
    "asymmetric": scan_with(covariances=np.array([np.eye(2), [[1.0, 0.1], [0.2, 1.0]]])),
    "infinite covariance": scan_with(covariances=np.array([np.eye(2), np.diag([np.inf, 1.0])])),
}


@pytest.mark.parametrize("name", BAD_SCANS)
def test_a_bad_measurement_is_refused_by_number_and_changes_nothing(name: str) -> None:
    m, _, _ = mapped()
    before = m.mean, m.covariance, m.seen
    with pytest.raises(ValueError, match="measurement 1"):
        m.update(BAD_SCANS[name], np.array([0, 1]))
    with pytest.raises(ValueError, match="measurement 1"):
        m.add(BAD_SCANS[name], np.array([1]))
    for old, new in zip(before, (m.mean, m.covariance, m.seen)):
        np.testing.assert_array_equal(old, new)
    m.update(BAD_SCANS[name], np.array([0, UNPAIRED]))  # unpaired, it does no harm


@pytest.mark.parametrize("features", [[0, -2], [0, 1000], [0]])
def test_pairings_that_make_no_sense_are_refused(features: list[int]) -> None:
    m, _, _ = mapped()
    mean = m.mean
    with pytest.raises(ValueError, match="features"):
        m.update(scan_with(), np.array(features))
    np.testing.assert_array_equal(m.mean, mean)
    with pytest.raises(ValueError, match="remove"):
        m.remove(np.array([0, m.n]))


@pytest.mark.parametrize(
    "odometry",
    [
        Odometry(np.array([0.0, np.nan, 0.0]), Q),
        Odometry(np.array([np.inf, 0.0, 0.0]), Q),
        Odometry(np.zeros(3), np.full((3, 3), np.nan)),
        Odometry(np.zeros(3), -Q),
        Odometry(np.zeros(3), np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 0.0], [2.0, 0.0, 1.0]])),
    ],
)
def test_bad_odometry_is_refused_and_changes_nothing(odometry: Odometry) -> None:
    m, _, _ = mapped()
    mean, covariance = m.mean, m.covariance
    with pytest.raises(ValueError, match="odometry"):
        m.predict(odometry)
    np.testing.assert_array_equal(m.mean, mean)
    np.testing.assert_array_equal(m.covariance, covariance)


def test_no_uncertainty_anywhere_is_refused() -> None:
    m, exact = StochasticMap(), scan_with(covariances=np.zeros((2, 2, 2)))
    m.add(exact, np.array([0]))
    with pytest.raises(ValueError, match="singular"):
        m.update(exact, np.array([0, UNPAIRED]))


@pytest.mark.parametrize(
    "arguments",
    [
        {"pose": [0.0, 0.0]},
        {"pose": [0.0, np.nan, 0.0]},
        {"pose_covariance": -np.eye(3)},
        {"pose_covariance": np.eye(2)},
        {"capacity": 0},
    ],
)
def test_a_map_that_cannot_start_says_why(arguments: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(arguments))):
        StochasticMap(**arguments)


@pytest.mark.parametrize("field", [{"confidence": 1.0}, {"confidence": 0.0}, {"unconfirmed_age": -1}])
def test_settings_out_of_range_are_refused(field: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(field))):
        MapSpec(**field)


NOISE = np.tile(0.01 * np.eye(2), (3, 1, 1))

# -- relocation ----------------------------------------------------------------------------------------------------


def test_landmarks_are_the_features_with_all_their_covariance_and_stay_as_they_were() -> None:
    slam_map = mapped(seed=5)[0]
    features = slam_map.landmarks()
    np.testing.assert_array_equal(features.positions.ravel(), slam_map.mean[3:])
    np.testing.assert_array_equal(features.covariance, slam_map.covariance[3:, 3:])
    for j in range(len(features)):
        block = features.covariance[2 * j : 2 * j + 2, 2 * j : 2 * j + 2]
        np.testing.assert_array_equal(features.covariances[j], block)
    before = features.covariance.copy()
    slam_map.update(make_scan(np.array([[1.0, 0.0]]), NOISE[:1]), np.array([0]))
    np.testing.assert_array_equal(features.covariance, before)


def test_a_robot_that_was_placed_knows_nothing_of_the_features_and_leaves_them_alone() -> None:
    slam_map = mapped(seed=6)[0]
    features, P = slam_map.mean[3:], slam_map.covariance[3:, 3:]
    covariance = np.diag([4.0, 4.0, 1.0])
    slam_map.place([1.0, 2.0, 7.0], covariance)
    np.testing.assert_allclose(slam_map.pose, [1.0, 2.0, 7.0 - 2.0 * np.pi])
    np.testing.assert_array_equal(slam_map.covariance[:3, :3], covariance)
    np.testing.assert_array_equal(slam_map.covariance[:3, 3:], 0.0)
    np.testing.assert_array_equal(slam_map.mean[3:], features)
    np.testing.assert_array_equal(slam_map.covariance[3:, 3:], P)
    with pytest.raises(ValueError, match="pose: expected 3 finite"):
        slam_map.place([0.0, np.nan, 0.0], covariance)
    with pytest.raises(ValueError, match="pose_covariance: not a 3 x 3"):
        slam_map.place([0.0, 0.0, 0.0], -covariance)


def test_kinds_are_those_last_reported_and_unknown_before() -> None:
    slam_map = StochasticMap()
    points = np.array([[1.0, 0.0], [2.0, 1.0], [0.0, 3.0]])
    slam_map.add(replace(make_scan(points, NOISE), kinds=np.array([1, UNKNOWN_KIND, 2])), np.arange(2))
    slam_map.add(make_scan(points, NOISE), np.array([2]))
    assert slam_map.kinds.tolist() == [1, UNKNOWN_KIND, UNKNOWN_KIND]
    told = replace(make_scan(points, NOISE), kinds=np.array([UNKNOWN_KIND, 0, 3]))
    slam_map.update(told, np.array([0, 1, UNPAIRED]))
    assert slam_map.kinds.tolist() == [1, 0, UNKNOWN_KIND] == slam_map.prediction(9.0).kinds.tolist()
