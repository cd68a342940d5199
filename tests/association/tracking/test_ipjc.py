"""IPJC against scipy's nonlinear optimum over the whole state, and against JCBB where nothing turns."""

import functools

import numpy as np
import pytest
from scipy.optimize import least_squares

from slam_gym.association import ASSOCIATORS, ipjc, jcbb
from slam_gym.association.prediction import predict
from slam_gym.geometry import observe
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import UNPAIRED, Scan
from tests.oracles import association as oracles
from tests.oracles.geometry import rigid_motions
from tests.oracles.statistics import for_seeds


def turning_problem(rng, m, n, heading_sigma, spread=3.0):
    """A robot of uncertain heading, correlated with its map; the scan is taken from a pose drawn, by the true h."""
    features = rng.uniform(-spread, spread, (n, 2))
    mixing = np.zeros((3 + 2 * n, 3 + 2 * n))
    mixing[:3, :3] = np.diag([0.2, 0.2, heading_sigma])
    mixing[3:] = 0.03 * rng.standard_normal((2 * n, 3 + 2 * n))
    P = mixing @ mixing.T + 1e-6 * np.eye(3 + 2 * n)
    H = np.hstack([-rigid_motions(features), np.eye(2 * n)])
    S, across = H @ P @ H.T, (H @ P[:, 2]).reshape(n, 2)
    state = np.concatenate([np.zeros(3), features.ravel()])
    drawn = state + np.linalg.cholesky(P) @ rng.standard_normal(len(P))
    sigma, points, truth = 0.05, rng.uniform(-spread, spread, (m, 2)), np.full(m, UNPAIRED)
    for i, j in zip(range(round(0.7 * min(m, n))), rng.permutation(n)):
        points[i], truth[i] = observe(drawn[:3], drawn[3:].reshape(-1, 2))[j] + sigma * rng.standard_normal(2), j
    order = rng.permutation(m)
    prediction = oracles.expecting(features, S, heading_variance=float(P[2, 2]), across=across)
    scan = Scan.from_points(points[order], sigma=sigma)
    return scan, prediction, state, P, truth[order]


def posterior_distance(scan, state, P, pairs):
    """Least cost of prior and measurements over the whole state, nonlinear, by scipy."""
    L, (measured, rows) = np.linalg.cholesky(P), np.array(pairs).T

    def residuals(whitened):
        x = state + L @ whitened
        off = scan.points[measured] - observe(x[:3], x[3:].reshape(-1, 2)[rows])
        return np.concatenate([whitened, (off / np.sqrt(scan.covariances[measured, 0, :1])).ravel()])

    return 2.0 * float(least_squares(residuals, np.zeros(len(P)), xtol=1e-12, ftol=1e-12, gtol=1e-12).cost)


@for_seeds(40)
def test_ipjc_is_the_best_path_by_the_nonlinear_optimum(seed):
    rng = np.random.default_rng(seed)
    scan, prediction, state, P, _ = turning_problem(
        rng, int(rng.integers(1, 5)), int(rng.integers(1, 5)), 0.3, spread=1.5
    )

    @functools.cache
    def distance(pairs):
        return posterior_distance(scan, state, P, pairs) if pairs else 0.0

    lists, best = oracles.compatible(scan, prediction, 0.99), (0, 0.0, ())
    paths = [((), 0)]
    while paths:
        pairs, level = paths.pop()
        best = min(best, (-len(pairs), distance(pairs), pairs))
        if level == len(scan):
            continue
        paths.append((pairs, level + 1))
        for _, j in lists[level]:
            longer = (*pairs, (level, j))
            if j not in dict(pairs).values() and distance(longer) < oracles.gate(2 * len(longer), 0.99):
                paths.append((longer, level + 1))
    rows = dict(best[2])
    answer = ipjc(scan, prediction)
    assert answer.features.tolist() == [rows.get(i, UNPAIRED) for i in range(len(scan))]
    assert answer.joint_distance == pytest.approx(best[1], rel=1e-5, abs=1e-6)


@for_seeds(150)
def test_ipjc_is_jcbb_where_nothing_turns(seed):
    scan, prediction, _ = oracles.smaller_problem(seed, locality=seed % 2 == 0)
    expected = jcbb(scan, prediction)
    for variance, close in ((0.0, 1e-8), (1e-12, 1e-4)):
        answer = ipjc(scan, oracles.turning_by(prediction, variance))
        assert answer.features.tolist() == expected.features.tolist()
        assert answer.joint_distance == pytest.approx(expected.joint_distance, rel=close, abs=close)


def test_ipjc_misses_fewer_pairings_than_jcbb_when_the_heading_is_far_off():
    missed = {"jcbb": 0, "ipjc": 0}
    for seed in range(60):
        scan, prediction, _, _, truth = turning_problem(np.random.default_rng(seed), 10, 10, 0.25, spread=8.0)
        for name in missed:
            features = ASSOCIATORS[name](scan, prediction).features
            missed[name] += int(((features != truth) & (truth != UNPAIRED)).sum())
    assert 0 < missed["ipjc"] < 0.7 * missed["jcbb"], missed


def test_a_prediction_of_second_order_does_not_count_the_heading_twice():
    places, answers = np.random.default_rng(3).uniform(2.0, 6.0, (6, 2)), []
    for second_order in (True, False):
        m = StochasticMap(MapSpec(second_order=second_order))
        m.add(Scan.from_points(places, sigma=0.02), np.arange(6))
        m.place(np.zeros(3), np.diag([0.05, 0.05, 0.2]) ** 2)
        turned = Scan.from_points(observe(np.array([0.0, 0.0, 0.2]), places), sigma=0.02)
        answers.append(ipjc(turned, predict(m, 20.0)))
    assert answers[0].features.tolist() == answers[1].features.tolist() == list(range(6))
    assert [answer.joint_distance for answer in answers] == pytest.approx([1.0, 1.0], abs=0.01)  # of one σ of heading


def test_ipjc_reports_its_node_limit():
    scan, prediction, *_ = turning_problem(np.random.default_rng(2), 12, 14, 0.1)
    free, stopped = ipjc(scan, prediction), ipjc(scan, prediction, node_limit=10)
    assert not free.effort.limit_hit and free.effort.nodes > 10 and free.pairings > 5
    assert stopped.effort.limit_hit and stopped.effort.nodes == 10 and stopped.pairings == 0
