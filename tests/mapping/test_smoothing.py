"""Batch least squares against a dense solver, the filter where all is linear, a loop, and a published optimum."""

import math
import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from slam_gym.geometry import compose, observe, relative, wrap_angle
from slam_gym.mapping.smoothing import Smoothed, smooth
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.metrics.consistency import nees
from slam_gym.recordings.recording import Recording, starts_of
from slam_gym.recordings.victoria_park import SOURCE, read_matlab
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Array, IntArray, Odometry, Scan, Truth
from tests.oracles.map import KnownAssociation, Step, make_scan, wander
from tests.recordings import drive

KEEP = MapSpec(unconfirmed_age=None)


def run_of(steps: list[Step]) -> tuple[list[Odometry], list[Scan], list[IntArray]]:
    """Odometry, scans and true pairings of steps."""
    return [step.odometry for step in steps], [step.scan for step in steps], [step.sources for step in steps]


@pytest.mark.parametrize("seed", range(3))
def test_optimum_and_covariance_are_those_of_a_dense_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    steps = list(wander(rng, 8, rng.uniform([-3.0, -2.0], [4.0, 5.0], (5, 2)), q=np.diag([0.1, 0.05, 0.08]) ** 2))
    odometry, scans, sources = run_of(steps)
    pairings = [1000 - 7 * seen for seen in sources]  # any numbers will do
    pairings[3][:2] = -1, -2
    best = smooth(odometry, scans, pairings)
    T = len(steps)

    def residuals(x: Array) -> Array:
        poses = np.vstack([odometry[0].motion, x[: 3 * (T - 1)].reshape(-1, 3)])
        positions, parts = x[3 * (T - 1) :].reshape(-1, 2), []
        for t in range(T):
            if t:
                error = relative(poses[t - 1], poses[t]) - odometry[t].motion
                error[2] = wrap_angle(error[2])
                parts.append(np.linalg.solve(np.linalg.cholesky(odometry[t].covariance), error))
            seen = observe(poses[t], positions)
            for point, covariance, number in zip(scans[t].points, scans[t].covariances, pairings[t]):
                if number >= 0:
                    error = seen[list(best.ids).index(number)] - point
                    parts.append(np.linalg.solve(np.linalg.cholesky(covariance), error))
        return np.concatenate(parts)

    start = np.concatenate([best.poses[1:].ravel(), best.positions.ravel()])
    start += 0.05 * rng.standard_normal(len(start))
    dense = least_squares(residuals, start, jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert best.chi2 == pytest.approx(2.0 * dense.cost, rel=1e-8)
    np.testing.assert_allclose(best.poses[1:].ravel(), dense.x[: 3 * (T - 1)], atol=1e-5)
    np.testing.assert_allclose(best.positions.ravel(), dense.x[3 * (T - 1) :], atol=1e-5)
    full = np.linalg.inv(dense.jac.T @ dense.jac)
    np.testing.assert_allclose(best.covariance(range(1, T), best.ids), full, rtol=1e-3, atol=1e-7)
    chosen = best.covariance([0, 4], best.ids[[2]])  # some of it, the pose that is held among them
    rows = np.r_[9:12, 3 * (T - 1) + 4 : 3 * (T - 1) + 6]
    np.testing.assert_allclose(chosen[3:, 3:], full[np.ix_(rows, rows)], rtol=1e-3, atol=1e-7)
    assert not chosen[:3].any() and not chosen[:, :3].any()


def test_equals_the_filter_where_the_heading_is_known() -> None:
    """Without noise of the heading all is linear (1e-6 rad stands for none), and filter and smoother are both exact."""
    rng = np.random.default_rng(3)
    q = np.diag([0.05, 0.03, 0.0]) ** 2
    steps = list(wander(rng, 40, rng.uniform([-4.0, -2.0], [5.0, 7.0], (20, 2)), reach=4.0, q=q))
    held = Odometry(steps[0].odometry.motion, np.zeros((3, 3)))  # the first pose
    steps[0] = replace(steps[0], odometry=held)
    filtered = KnownAssociation(StochasticMap(KEEP))
    for step in steps:
        filtered.step(step)
    odometry, scans, pairings = run_of(steps)
    best = smooth([Odometry(u.motion, u.covariance + np.diag([0, 0, 1e-12])) for u in odometry], scans, pairings)
    order = np.argsort(filtered.sources)
    rows = np.concatenate([np.arange(3), (3 + 2 * order[:, None] + np.arange(2)).ravel()])
    state = np.concatenate([best.poses[-1], best.positions.ravel()])
    np.testing.assert_allclose(state, filtered.map.mean[rows], atol=1e-5)
    covariance = best.covariance([len(steps) - 1], best.ids)
    np.testing.assert_allclose(covariance, filtered.map.covariance[np.ix_(rows, rows)], atol=1e-7)


# --- a loop -----------------------------------------------------------------------------------------------------------

RING = np.column_stack([np.sin(np.arange(48) * math.tau / 48), 1.0 - np.cos(np.arange(48) * math.tau / 48)])
WORLD = np.vstack([[0.0, 8.0] + (RING - [0.0, 1.0]) * radius for radius in (6.0, 10.0)])


def loop(rng: np.random.Generator, steps: int = 66) -> Iterator[Step]:
    """A robot on a ring of radius 8 m, once round and a third further, among features at 6 and 10 m from its centre."""
    pose, q = np.zeros(3), np.diag([0.03, 0.03, 0.02]) ** 2
    for step in range(steps):
        motion = np.array([1.0, 0.0, 1.0 / 8.0]) if step else np.zeros(3)
        noise = rng.multivariate_normal(np.zeros(3), q) if step else np.zeros(3)
        pose = compose(pose, motion + noise)
        seen = observe(pose, WORLD)
        sources = np.flatnonzero((np.hypot(*seen.T) < 4.0) & (seen[:, 0] > 0.0))
        points = seen[sources] + 0.05 * rng.standard_normal((len(sources), 2))
        covariances = np.tile(0.05**2 * np.eye(2), (len(sources), 1, 1))
        yield Step(Odometry(motion, q), make_scan(points, covariances), sources, pose)


def off(best: Smoothed, steps: list[Step]) -> float:
    """Root mean square distance [m] of the poses from the true ones."""
    true = np.array([step.pose[:2] for step in steps])
    return math.sqrt(((best.poses[:, :2] - true) ** 2).sum(axis=1).mean())


def test_a_closed_loop_is_nearer_to_the_truth_than_an_open_one_and_knows_how_near() -> None:
    closed, open_, total, dof, fit, fit_dof = [], [], 0.0, 0, 0.0, 0
    for seed in range(40):
        steps = list(loop(np.random.default_rng(seed)))
        odometry, scans, sources = run_of(steps)
        anew = [seen + 1000 * (t >= 40) for t, seen in enumerate(sources)]  # nothing is recognised in the second half
        best = smooth(odometry, scans, sources)
        closed.append(off(best, steps))
        open_.append(off(smooth(odometry, scans, anew), steps))
        asked, ids = [20, len(steps) - 1], best.ids[::6]
        truth = np.concatenate([steps[20].pose, steps[-1].pose, WORLD[ids].ravel()])
        error = np.concatenate([best.poses[asked].ravel(), best.positions[::6].ravel()]) - truth
        error[[2, 5]] = [wrap_angle(error[2]), wrap_angle(error[5])]
        total, dof = total + nees(error, best.covariance(asked, ids)), dof + len(error)
        fit, fit_dof = fit + best.chi2, fit_dof + 2 * sum(map(len, sources)) - 2 * len(best.ids)
    assert np.mean(closed) < 0.6 * np.mean(open_)
    for value, freedom in ((total, dof), (fit, fit_dof)):
        low, high = chi2.ppf([0.0005, 0.9995], freedom)
        assert low < value < high


def test_where_the_search_begins_matters_only_in_its_shape() -> None:
    log = drive(1)
    best = smooth(*zip(*log.steps()))
    away = np.array([compose(np.array([50.0, -20.0, 2.0]), pose) for pose in best.poses])
    again = smooth(*zip(*log.steps()), initial=away)
    assert again.iterations <= 3 < best.iterations + 2
    np.testing.assert_allclose(again.poses, best.poses, atol=1e-4)
    scaled = [
        (replace(u, covariance=1e8 * u.covariance), replace(s, covariances=1e8 * s.covariances), seen)
        for u, s, seen in log.steps()
    ]
    np.testing.assert_allclose(smooth(*zip(*scaled)).poses, best.poses, atol=1e-4)  # all σ may be wrong by one factor


# --- what is refused --------------------------------------------------------------------------------------------------


def test_what_cannot_be_smoothed_is_refused_by_name() -> None:
    odometry, scans, pairings = (list(part) for part in zip(*drive(steps=4).steps()))
    initial, nan = np.zeros((4, 3)), math.nan
    broken = replace(scans[2], points=np.full_like(scans[2].points, nan))
    flat = replace(scans[1], covariances=np.zeros_like(scans[1].covariances))
    sure = Odometry(odometry[3].motion, np.diag([1e-4, 1e-4, 0.0]))
    lost = Odometry(np.array([nan, 0.0, 0.0]), odometry[1].covariance)
    none = [np.full(len(scan), -1) for scan in scans]
    cases = [
        ((odometry, scans[:3], pairings), "scans, pairings: 3 and 4 of them for 4"),
        ((odometry, scans, [*pairings[:3], pairings[3][:1]]), r"pairings\[3\]: int64 of shape \(1,\)"),
        ((odometry, scans, [pairings[0] * 0.5, *pairings[1:]]), r"pairings\[0\]: float64"),
        ((odometry, scans, none), "pairings: no measurement is paired"),
        (([], [], []), "pairings: no measurement is paired"),
        ((odometry, [*scans[:2], broken, scans[3]], pairings), r"scans\[2\]: is not finite"),
        ((odometry, [scans[0], flat, *scans[2:]], pairings), r"scans\[1\]: has a covariance that is not positive"),
        (([odometry[0], lost, *odometry[2:]], scans, pairings), r"odometry\[1\]: is not finite"),
        (([*odometry[:3], sure], scans, pairings), r"odometry\[3\]: has a covariance that is not positive definite"),
        ((odometry, scans, pairings, initial[:3]), r"initial: shape \(3, 3\)"),
        ((odometry, scans, pairings, initial + nan), "initial"),
    ]
    for arguments, message in cases:
        with pytest.raises(ValueError, match=message):
            smooth(*arguments)
    best = smooth(odometry, scans, pairings)
    mask = np.arange(4) == 2
    for asked in ({"poses": [4]}, {"poses": [-1]}, {"poses": mask}, {"ids": [999]}, {"ids": [0.5]}):
        message = f"{next(iter(asked))}:"
        with pytest.raises(ValueError, match=message):
            best.covariance(**asked)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(best)).covariance(2), best.covariance([2]))


# --- a published optimum ----------------------------------------------------------------------------------------------


def victoria_park_clean(path: Path) -> Recording:
    """The log as Huang, Wang and Dissanayake cleaned it (`VicPark_clean_data.mat`): motions and labelled points.

    Its least-squares optimum is known: χ² = 9012.7193. Steps are numbered, not timed.
    """
    (rows,) = read_matlab(path, "VicPark_clean_data")
    moves, looks = rows[rows[:, 0] == 1.0], rows[rows[:, 0] == 0.0]
    steps = len(moves) + 1
    assert np.array_equal(moves[:, 2], np.arange(1, steps)) and np.array_equal(moves[:, 1], np.arange(steps - 1))
    looks = looks[np.argsort(looks[:, 1], kind="stable")]
    motions, covariances = np.zeros((steps, 3)), np.tile(1e-4**2 * np.eye(3), (steps, 1, 1))
    motions[1:] = moves[:, 3:6]
    covariances[1:] = moves[:, [6, 7, 8, 7, 9, 10, 8, 10, 11]].reshape(-1, 3, 3)
    return Recording(
        name="victoria_park_clean",
        source=SOURCE,
        terms="",
        times=np.arange(steps, dtype=np.float64),
        motions=motions,
        motion_covariances=covariances,
        starts=starts_of(np.bincount(looks[:, 1].astype(np.int64), minlength=steps)),
        points=looks[:, 3:5].copy(),
        covariances=looks[:, [5, 6, 6, 7]].reshape(-1, 2, 2).copy(),
        sources=looks[:, 2].astype(np.int64),
        range=80.0,
        field_of_view=math.pi,
    )


@pytest.mark.slow
def test_the_published_optimum_of_victoria_park(data_dir) -> None:
    log = victoria_park_clean(data_dir / "victoria_park" / "VicPark_clean_data.mat")
    slam, poses = Slam(SlamSpec(MapSpec(unconfirmed_age=None), reach=1e3)), []
    judged = JudgedSlam(slam, "true_association")
    for odometry, scan, sources in log.steps():
        judged.step(odometry, scan, Truth(np.zeros(3), sources))
        poses.append(slam.map.pose)
    best = smooth(*zip(*log.steps()), initial=np.array(poses))
    assert len(best.ids) == 299 and abs(best.chi2 - 9012.7193) < 1e-3
