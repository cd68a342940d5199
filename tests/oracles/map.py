"""EKF-SLAM as in the textbook, with full matrices and numpy only, and a small world to run it in."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slam_gym.geometry import compose, compose_jacobians, observe, transform, wrap_angle
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import UNPAIRED, Array, IntArray, Odometry, Scan
from tests.oracles.geometry import block_diagonal, observe_jacobians, transform_jacobians


class TextbookMap:
    """x and P in full; Jacobians from `oracles.geometry`; Joseph form. Known associations, no bookkeeping."""

    def __init__(self, pose: Array, pose_covariance: Array) -> None:
        self.x, self.P = pose.copy(), pose_covariance.copy()

    @property
    def n(self) -> int:
        return (len(self.x) - 3) // 2

    def predict(self, odometry: Odometry) -> None:
        F, G = compose_jacobians(self.x[:3], odometry.motion)
        pose = compose(self.x[:3], odometry.motion)
        full = np.eye(len(self.x))
        full[:3, :3] = F
        noise = np.zeros_like(self.P)
        noise[:3, :3] = G @ odometry.covariance @ G.T
        self.x[:3] = pose
        self.P = full @ self.P @ full.T + noise

    def H(self, features: IntArray) -> Array:
        out = np.zeros((2 * len(features), len(self.x)))
        for row, j in enumerate(features):
            f = slice(3 + 2 * j, 5 + 2 * j)
            out[2 * row : 2 * row + 2, :3], out[2 * row : 2 * row + 2, f] = observe_jacobians(self.x[:3], self.x[f])
        return out

    def h(self, features: IntArray) -> Array:
        return observe(self.x[:3], self.x[3:].reshape(-1, 2)[features])

    def update(self, scan: Scan, features: IntArray) -> None:
        paired = np.flatnonzero(features != UNPAIRED)
        H, R = self.H(features[paired]), block_diagonal(scan.covariances[paired])
        nu = (scan.points[paired] - self.h(features[paired])).ravel()
        K = np.linalg.solve(H @ self.P @ H.T + R, H @ self.P).T
        left = np.eye(len(self.x)) - K @ H
        self.x = self.x + K @ nu
        self.x[2] = wrap_angle(self.x[2])
        self.P = left @ self.P @ left.T + K @ R @ K.T

    def add(self, scan: Scan, measurements: IntArray) -> None:
        for i in measurements:
            position = transform(self.x[:3], scan.points[i : i + 1])[0]
            Jp, Jz = transform_jacobians(self.x[:3], scan.points[i])
            across = Jp @ self.P[:3]
            corner = Jp @ self.P[:3, :3] @ Jp.T + Jz @ scan.covariances[i] @ Jz.T
            self.P = np.block([[self.P, across.T], [across, corner]])
            self.x = np.concatenate([self.x, position])

    def remove(self, features: IntArray) -> None:
        gone = np.concatenate([3 + 2 * features, 4 + 2 * features])
        self.x = np.delete(self.x, gone)
        self.P = np.delete(np.delete(self.P, gone, axis=0), gone, axis=1)


@dataclass(frozen=True)
class Step:
    """One step of the small world: what the robot is told, and the truth behind it."""

    odometry: Odometry
    scan: Scan
    sources: IntArray  # (m,) landmark behind each measurement
    pose: Array  # (3,) true pose in B


Q = np.diag([0.02, 0.01, 0.01]) ** 2  # [m, m, rad] of the odometry
SIGMA = 0.05  # [m] of a measured point, the longer axis


def wander(
    rng: np.random.Generator, steps: int, landmarks: Array, reach: float = 5.0, turn: float = 0.15, q: Array = Q
) -> Iterator[Step]:
    """A robot circling from the origin with step length .3 m, measuring every landmark within `reach` [m]."""
    pose = np.zeros(3)
    for _ in range(steps):
        motion = np.array([0.3, 0.0, turn])
        pose = compose(pose, rng.multivariate_normal(motion, q, method="svd"))
        seen = observe(pose, landmarks)
        sources = np.flatnonzero(np.hypot(*seen.T) < reach)
        covariances = random_covariances(rng, SIGMA, len(sources))
        noise = np.linalg.cholesky(covariances) @ rng.standard_normal((len(sources), 2, 1))
        points = seen[sources] + noise[:, :, 0]
        yield Step(Odometry(motion, q), make_scan(points, covariances), sources, pose)


def random_covariances(rng: np.random.Generator, sigma: float, count: int) -> Array:
    """(count, 2, 2), each with axes sigma and a random smaller one, in a random direction."""
    drawn = rng.random((count, 2))
    angle, second = np.pi * drawn[:, 0], sigma * (0.2 + 0.8 * drawn[:, 1])
    c, s = np.cos(angle), np.sin(angle)
    C = np.array([[c, -s], [s, c]]).transpose(2, 0, 1)
    axes = np.column_stack([np.full(count, sigma), second])
    covariances = (C * axes[:, None, :] ** 2) @ C.transpose(0, 2, 1)
    return (covariances + covariances.transpose(0, 2, 1)) / 2


def make_scan(points: Array, covariances: Array, sizes: Array | None = None, variances: Array | None = None) -> Scan:
    """A scan of unknown sizes, unless they are given."""
    unknown = np.full(len(points), np.nan)
    points, covariances = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(covariances)
    return Scan(points, covariances, unknown if sizes is None else sizes, unknown if variances is None else variances)


class KnownAssociation:
    """Runs a StochasticMap (and a TextbookMap beside it, if given) on steps whose sources are known."""

    def __init__(self, stochastic_map: StochasticMap, textbook: TextbookMap | None = None) -> None:
        self.map, self.textbook = stochastic_map, textbook
        self.sources: list[int] = []  # landmark behind each map feature

    def step(self, step: Step) -> None:
        index = {source: j for j, source in enumerate(self.sources)}
        features = np.array([index.get(source, UNPAIRED) for source in step.sources.tolist()], dtype=np.int64)
        new = np.flatnonzero(features == UNPAIRED)
        for m in (self.map, self.textbook):
            if m is not None:
                m.predict(step.odometry)
                m.update(step.scan, features)
                m.add(step.scan, new)
        self.sources += step.sources[new].tolist()
        self.map.end_of_step()
