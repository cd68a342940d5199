"""Slow, direct definitions of the searches without a prior, and problems to hold the fast ones against.

Nothing here calls the package's own constraints, location or searches.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from slam_gym.types import UNKNOWN, Array, Landmarks, Scan


def random_covariance(rng: np.random.Generator, sigma: float) -> Array:
    a = rng.standard_normal((2, 2))
    return sigma**2 * (a @ a.T + 0.5 * np.eye(2))


def correlated(rng: np.random.Generator, positions: Array, sigma: float, drift: float) -> Array:
    """A joint covariance (2n, 2n): own errors of about `sigma` [m], and a drift [m, and per 10 m rad] common to all."""
    n = len(positions)
    J = np.zeros((2 * n, 3))
    J[0::2, 0] = J[1::2, 1] = 1.0
    J[0::2, 2], J[1::2, 2] = -positions[:, 1] / 10.0, positions[:, 0] / 10.0
    own = np.zeros((2 * n, 2 * n))
    for j in range(n):
        own[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] = random_covariance(rng, sigma)
    return own + drift**2 * J @ J.T


def landmarks_of(positions: Array, covariance: Array, *, keep: str = "dense", **given: Array) -> Landmarks:
    """Landmarks of a joint covariance (2n, 2n), kept `dense`, as `blocks` of all pairs, or not at all (`none`)."""
    n = len(positions)
    P = covariance.reshape(n, 2, n, 2).transpose(0, 2, 1, 3) if n else np.empty((0, 0, 2, 2))
    starts, columns, blocks = np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 2, 2))
    if keep == "blocks":
        pairs = [(j, l) for j in range(n) for l in range(n) if j != l]
        starts = np.arange(n + 1) * (n - 1)
        columns = np.array([l for _, l in pairs], np.int64)
        blocks = np.array([P[j, l] for j, l in pairs]).reshape(-1, 2, 2)
    return Landmarks(
        np.array(positions, float).reshape(n, 2),
        np.array([P[j, j] for j in range(n)]).reshape(n, 2, 2),
        given.get("sizes", np.full(n, np.nan)),
        given.get("size_variances", np.full(n, np.nan)),
        given.get("kinds", np.full(n, UNKNOWN)),
        np.array(covariance) if keep == "dense" else np.empty((0, 0)),
        starts,
        columns,
        blocks,
    )


def scan_of(points: Array, covariances: Array, **given: Array) -> Scan:
    m = len(points)
    unknown = np.full(m, np.nan)
    sizes, variances = given.get("sizes", unknown), given.get("size_variances", unknown)
    return Scan(
        np.array(points, float).reshape(m, 2), covariances.reshape(m, 2, 2), sizes, variances, given.get("kinds")
    )


def rotation(angle: float) -> Array:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def view(rng: np.random.Generator, pose: Array, positions: Array, sigma: float) -> tuple[Array, Array]:
    """Measurements (k, 2) in R, and their covariances, of true `positions` from `pose`."""
    R = np.array([random_covariance(rng, sigma) for _ in positions]).reshape(-1, 2, 2)
    exact = (positions - pose[:2]) @ rotation(pose[2])
    noise = [np.linalg.cholesky(r) @ rng.standard_normal(2) for r in R]
    return exact + np.reshape(noise, (-1, 2)), R


def errors(pose: Array, z: Array, F: Array) -> Array:
    """e (k, 2) = F − pose ⊕ z."""
    return F - pose[:2] - z @ rotation(pose[2]).T


def gate(dof: int, confidence: float) -> float:
    """χ²_{dof,conf}."""
    return float(chi2.ppf(confidence, dof))


def agree_in_what_they_are(scan: Scan, landmarks: Landmarks, i: int, j: int, confidence: float) -> bool:
    """The unary constraint."""
    kinds = {UNKNOWN if scan.kinds is None else scan.kinds[i], landmarks.kinds[j]} - {UNKNOWN}
    if len(kinds) == 2:
        return False
    variance = scan.size_variances[i] + landmarks.size_variances[j]
    difference = scan.sizes[i] - landmarks.sizes[j]
    return bool(np.isnan(difference + variance) or difference**2 <= gate(1, confidence) * variance)


def agree_in_distance(
    scan: Scan, landmarks: Landmarks, P: Array, first: tuple[int, int], second: tuple[int, int], confidence: float
) -> bool:
    """The binary constraint; P (2n, 2n) is the joint covariance of the map."""
    (i, j), (k, l) = first, second
    along, between = scan.points[k] - scan.points[i], landmarks.positions[l] - landmarks.positions[j]
    D = np.zeros((2, len(P)))
    D[:, 2 * l : 2 * l + 2] += np.eye(2)
    D[:, 2 * j : 2 * j + 2] -= np.eye(2)
    of_scan, of_map = scan.covariances[i] + scan.covariances[k], D @ P @ D.T
    error = np.linalg.norm(along) - np.linalg.norm(between)
    widest = np.linalg.eigvalsh(of_scan).max() + np.linalg.eigvalsh(of_map).max()
    if min(along @ along, between @ between) < 16.0 * widest:
        return bool(error**2 < gate(2, confidence) * widest)
    u, v = along / np.linalg.norm(along), between / np.linalg.norm(between)
    return bool(error**2 < gate(1, confidence) * (u @ of_scan @ u + v @ of_map @ v))


def area(points: Array) -> float:
    """Signed, of a triangle (3, 2)."""
    return float(0.5 * np.linalg.det(np.column_stack([np.ones(3), points])))


def same_sense(scan: Scan, landmarks: Landmarks, P: Array, pairs: list[tuple[int, int]], confidence: float) -> bool:
    """Orientation of three pairings, its gradients by central differences (the area is quadratic: they are exact)."""
    rows, columns = [i for i, _ in pairs], np.array([j for _, j in pairs])
    entries = (2 * columns[:, None] + np.arange(2)).ravel()
    z, F, R = scan.points[rows], landmarks.positions[columns], np.zeros((6, 6))
    for a, i in enumerate(rows):
        R[2 * a : 2 * a + 2, 2 * a : 2 * a + 2] = scan.covariances[i]
    if area(z) * area(F) >= 0.0:
        return True
    steps = np.eye(6).reshape(6, 3, 2)
    of_scan = np.array([area(z + s) - area(z - s) for s in steps]) / 2.0
    of_map = np.array([area(F + s) - area(F - s) for s in steps]) / 2.0
    variance = of_scan @ R @ of_scan + of_map @ P[np.ix_(entries, entries)] @ of_map
    return bool((area(z) - area(F)) ** 2 < gate(1, confidence) * variance)


def fit(scan: Scan, landmarks: Landmarks, P: Array, pairs: list[tuple[int, int]]) -> tuple[Array, Array, float]:
    """Pose, covariance and D² of pairings (measurement, feature), by a library's least squares from many starts.

    S is rotated with the pose and held while the errors are minimised, until both agree.
    """
    rows = np.array([j for _, j in pairs])
    z, F = scan.points[[i for i, _ in pairs]], landmarks.positions[rows]
    entries = (2 * rows[:, None] + np.arange(2)).ravel()
    P = P[np.ix_(entries, entries)]
    best: tuple[float, Array, Array] = (np.inf, np.full(3, np.nan), np.full((3, 3), np.nan))
    for heading in np.arange(4) * np.pi / 2.0:
        pose = np.array([*(F.mean(0) - rotation(heading) @ z.mean(0)), heading])
        for _ in range(20):
            C, S = rotation(pose[2]), P.copy()
            for a, (i, _) in enumerate(pairs):
                S[2 * a : 2 * a + 2, 2 * a : 2 * a + 2] += C @ scan.covariances[i] @ C.T
            root = np.linalg.inv(np.linalg.cholesky(S))
            found = least_squares(
                lambda x, w=root: w @ errors(x, z, F).ravel(), pose, xtol=1e-14, ftol=1e-14, gtol=1e-14
            )
            if np.abs(found.x - pose).max() < 1e-11:
                break
            pose = found.x
        if 2.0 * found.cost < best[0]:
            best = (2.0 * found.cost, found.x, np.linalg.inv(found.jac.T @ found.jac))
    return best[1], best[2], best[0]
