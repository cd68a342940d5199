"""Slow, direct definitions of the searches without a prior, and problems to hold the fast ones against.

Nothing here calls the package's own constraints, location or searches.
"""

import dataclasses
import itertools

import numpy as np
from scipy.optimize import least_squares

from slam_gym.geometry import wrap_angle
from slam_gym.types import UNKNOWN_KIND, Array, Landmarks, Locality, Relocation, Scan
from tests.oracles.association import decisions, gate, random_covariance
from tests.oracles.geometry import block_diagonal, rigid_motions

Pairs = list[tuple[int, int]]


def correlated(rng: np.random.Generator, positions: Array, sigma: float, drift: float) -> Array:
    """A joint covariance (2n, 2n): own errors of about `sigma` [m], and a drift [m, and per 10 m rad] common to all."""
    J = rigid_motions(positions)
    J[:, 2] /= 10.0
    own = np.array([random_covariance(rng, sigma) for _ in positions])
    return block_diagonal(own) + drift**2 * J @ J.T


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
        given.get("kinds", np.full(n, UNKNOWN_KIND)),
        np.array(covariance) if keep == "dense" else np.empty((0, 0)),
        starts,
        columns,
        blocks,
    )


def scan_of(points: Array, covariances: Array, **given: Array) -> Scan:
    return dataclasses.replace(Scan.from_points(points, covariances), **given)


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


def agree_in_what_they_are(scan: Scan, landmarks: Landmarks, i: int, j: int, confidence: float) -> bool:
    """The unary constraint."""
    kinds = {scan.kinds[i], landmarks.kinds[j]} - {UNKNOWN_KIND}
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
    J, L = slice(2 * j, 2 * j + 2), slice(2 * l, 2 * l + 2)
    of_scan, of_map = scan.covariances[i] + scan.covariances[k], P[J, J] + P[L, L] - P[J, L] - P[L, J]
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
    z, F, R = scan.points[rows], landmarks.positions[columns], block_diagonal(scan.covariances[rows])
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
    P, R = P[np.ix_(entries, entries)], scan.covariances[[i for i, _ in pairs]]
    best: tuple[float, Array, Array] = (np.inf, np.full(3, np.nan), np.full((3, 3), np.nan))
    for heading in np.arange(4) * np.pi / 2.0:
        pose = np.array([*(F.mean(0) - rotation(heading) @ z.mean(0)), heading])
        for _ in range(20):
            C = rotation(pose[2])
            S = P + block_diagonal(C @ R @ C.T)
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


def problem(
    rng: np.random.Generator, m: int, n: int, *, keep: str = "dense", spread: float = 2.5, sigma: float = 0.06
) -> tuple[Scan, Landmarks, Array]:
    """A scan of m measurements, most of them true, before a small map of n correlated features, crowded on purpose."""
    true = rng.uniform(-spread, spread, (n, 2))
    P = correlated(rng, true, sigma, 0.1)
    mapped = true + (np.linalg.cholesky(P + 1e-15 * np.eye(2 * n)) @ rng.standard_normal(2 * n)).reshape(n, 2)
    pose = np.array([*rng.uniform(-2.0, 2.0, 2), rng.uniform(-np.pi, np.pi)])
    real = rng.permutation(n)[: rng.binomial(m, 0.7)]
    spurious = pose[:2] + rng.uniform(-spread, spread, (m - len(real), 2))
    points, noise = view(rng, pose, np.vstack([true[real], spurious]), sigma)
    order = rng.permutation(m)
    sizes = {"sizes": rng.choice([0.3, 0.5, np.nan], n), "size_variances": np.full(n, 0.01)}
    landmarks = landmarks_of(mapped, P, keep=keep, **sizes)
    seen = np.concatenate([sizes["sizes"][real], rng.choice([0.3, 0.5], m - len(real))])[order]
    scan = scan_of(points[order], noise[order], sizes=seen, size_variances=np.full(m, 0.001))
    return scan, landmarks, P if keep != "none" else P * np.kron(np.eye(n), np.ones((2, 2)))


def locality_of(related: Array) -> Locality:
    """From a symmetric matrix (n, n), true on its diagonal."""
    rows = [np.flatnonzero(row) for row in related]
    starts = np.concatenate([[0], np.cumsum([len(row) for row in rows])]).astype(np.int64)
    return Locality(starts, np.concatenate([*rows, []]).astype(np.int64))


def localities(rng: np.random.Generator, landmarks: Landmarks) -> dict[str, Locality | None]:
    """Nothing restricted; neighbours within a distance; a random symmetric relation."""
    n = len(landmarks)
    apart = np.linalg.norm(landmarks.positions[:, None] - landmarks.positions, axis=2)
    chance = np.triu(rng.random((n, n)) < 0.6)
    return {
        "everything": None,
        "distance": locality_of(apart < 3.0),
        "covisibility": locality_of(chance | chance.T | np.eye(n, dtype=bool)),
    }


def quick_fit(scan: Scan, landmarks: Landmarks, P: Array, pairs: Pairs) -> tuple[Array, Array, float]:
    """`fit` by the normal equations, written out; for enumerations."""
    rows = np.array([j for _, j in pairs])
    z, F = scan.points[[i for i, _ in pairs]], landmarks.positions[rows]
    entries = (2 * rows[:, None] + np.arange(2)).ravel()
    R = scan.covariances[[i for i, _ in pairs]]
    dz, dF = z - z.mean(0), F - F.mean(0)
    heading = np.arctan2((dz[:, 0] * dF[:, 1] - dz[:, 1] * dF[:, 0]).sum(), (dz * dF).sum())
    pose = np.array([*(F.mean(0) - rotation(heading) @ z.mean(0)), heading])
    for _ in range(60):
        C = rotation(pose[2])
        S = P[np.ix_(entries, entries)] + block_diagonal(C @ R @ C.T)
        turned = z @ C.T
        A = np.zeros((2 * len(pairs), 3))
        A[0::2, 0] = A[1::2, 1] = 1.0
        A[0::2, 2], A[1::2, 2] = -turned[:, 1], turned[:, 0]
        e, W = (F - pose[:2] - turned).ravel(), np.linalg.inv(S)
        step = np.linalg.solve(A.T @ W @ A, A.T @ W @ e)
        pose = pose + step
        if np.abs(step).max() < 1e-9:
            break
    e = errors(pose, z, F).ravel()
    return pose, np.linalg.inv(A.T @ W @ A), float(e @ W @ e)


def legal(
    scan: Scan, landmarks: Landmarks, P: Array, related: Array | None, pairs: Pairs, new: tuple[int, int], conf: float
) -> bool:
    """Whether a pairing may follow others: unused, local to the first, and consistent with all of them."""
    i, j = new
    if any(j == used for _, used in pairs) or not agree_in_what_they_are(scan, landmarks, i, j, conf):
        return False
    if pairs and related is not None and not related[pairs[0][1], j]:
        return False
    if not all(agree_in_distance(scan, landmarks, P, pair, new, conf) for pair in pairs):
        return False
    return all(same_sense(scan, landmarks, P, [pairs[0], pair, new], conf) for pair in pairs[1:])


def relation(locality: Locality | None, n: int) -> Array | None:
    """The matrix (n, n) of a locality."""
    if locality is None:
        return None
    related = np.zeros((n, n), bool)
    for j in range(n):
        related[j, locality.of(j)] = True
    return related


def holds(scan: Scan, landmarks: Landmarks, P: Array, pairs: Pairs, confidence: float) -> bool:
    """Joint compatibility of the located hypothesis."""
    return quick_fit(scan, landmarks, P, pairs)[2] < gate(2 * len(pairs) - 3, confidence)


def gcbb(scan: Scan, landmarks: Landmarks, P: Array, locality: Locality | None, confidence: float) -> list[Pairs]:
    """All hypotheses with most pairings: every path of the tree enumerated, then the largest that hold. No bound."""
    related, n = relation(locality, len(landmarks)), len(landmarks)
    paths: list[Pairs] = [[]]
    for i in range(len(scan)):
        longer = [
            [*path, (i, j)]
            for path in paths
            for j in range(n)
            if legal(scan, landmarks, P, related, path, (i, j), confidence)
        ]
        paths += longer
    for k in range(len(scan), 1, -1):
        best = [path for path in paths if len(path) == k and holds(scan, landmarks, P, path, confidence)]
        if best:
            return best
    return []


def mutual(scan: Scan, landmarks: Landmarks, P: Array, related: Array | None, confidence: float) -> list[Pairs]:
    """All sets of pairings that agree in distance and are local each to each."""
    paths: list[Pairs] = [[]]
    for i in range(len(scan)):
        for path in list(paths):
            for j in range(len(landmarks)):
                if any(j == l or (related is not None and not related[j, l]) for _, l in path):
                    continue
                if agree_in_what_they_are(scan, landmarks, i, j, confidence) and all(
                    agree_in_distance(scan, landmarks, P, pair, (i, j), confidence) for pair in path
                ):
                    paths.append([*path, (i, j)])
    return paths


def compatible_at(
    scan: Scan, landmarks: Landmarks, pose: Array, covariance: Array, i: int, j: int, confidence: float
) -> bool:
    """Individual compatibility at a located pose, taken for independent of the feature."""
    C, d = rotation(pose[2]).T, landmarks.positions[j] - pose[:2]
    H = np.column_stack([-C, C @ [d[1], -d[0]]])
    S = H @ covariance @ H.T + C @ landmarks.covariances[j] @ C.T + scan.covariances[i]
    nu = scan.points[i] - C @ d
    return bool(nu @ np.linalg.solve(S, nu) < gate(2, confidence))


def random_sampling(
    scan: Scan, landmarks: Landmarks, P: Array, locality: Locality | None, confidence: float
) -> list[Pairs]:
    """All hypotheses with most pairings that some ordered sample of three leads to, every one of them enumerated."""
    related, m, n = relation(locality, len(landmarks)), len(scan), len(landmarks)
    found: list[Pairs] = []
    for sample in itertools.permutations(range(m), 3):
        paths: list[Pairs] = [[]]
        for i in sample:
            paths = [
                [*path, (i, j)]
                for path in paths
                for j in range(n)
                if legal(scan, landmarks, P, related, path, (i, j), confidence)
            ]
        for path in paths:
            if holds(scan, landmarks, P, path, confidence):
                found += _extensions(scan, landmarks, P, related, path, confidence)
    most = max(map(len, found), default=0)
    return [pairs for pairs in found if len(pairs) == most]


def _extensions(
    scan: Scan, landmarks: Landmarks, P: Array, related: Array | None, pairs: Pairs, confidence: float
) -> list[Pairs]:
    pose, covariance, _ = quick_fit(scan, landmarks, P, pairs)
    local = range(len(landmarks)) if related is None else np.flatnonzero(related[pairs[0][1]])
    paths = [pairs]
    for i in set(range(len(scan))) - {i for i, _ in pairs}:
        for path in list(paths):
            for j in local:
                if j in [used for _, used in path] or not agree_in_what_they_are(scan, landmarks, i, j, confidence):
                    continue
                if not compatible_at(scan, landmarks, pose, covariance, i, j, confidence):
                    continue
                if holds(scan, landmarks, P, [*path, (i, j)], confidence):
                    paths.append([*path, (i, j)])
    return paths


def small_problem(seed: int, *, largest: int = 5) -> tuple[Scan, Landmarks, Array, dict[str, Locality | None]]:
    """One that every hypothesis can be enumerated of, with its joint covariance and localities."""
    rng = np.random.default_rng(seed)
    m, n = int(rng.integers(3, largest + 1)), int(rng.integers(3, 9))
    scan, landmarks, P = problem(rng, min(m, n), n, keep=("dense", "blocks", "none")[seed % 3])
    return scan, landmarks, P, localities(rng, landmarks)


def check_against(
    found: Relocation, best: list[Pairs], scan: Scan, landmarks: Landmarks, P: Array, *, ties: bool = True
) -> None:
    """`found` is one of the best hypotheses, located as the oracle does, and ties are the others elsewhere."""
    if not best:
        assert found.pairings == 0 and np.isnan(found.pose).all() and not found.ambiguous
        return
    assert found.pairings == len(best[0])
    if found.pairings == 2:  # with one degree of freedom and close points the optimum need not be the only one
        return
    distinct = {tuple(decisions(pairs, len(scan))): pairs for pairs in best}
    fits = {key: quick_fit(scan, landmarks, P, pairs) for key, pairs in distinct.items()}
    assert tuple(found.features) in distinct
    pose, covariance, distance = fits[tuple(found.features)]
    least = min(distance for _, _, distance in fits.values())
    assert np.isclose(found.joint_distance, distance, rtol=1e-4, atol=1e-6)
    assert np.isclose(found.joint_distance, least, rtol=1e-4, atol=1e-6)
    assert found.dof == 2 * len(best[0]) - 3
    np.testing.assert_allclose(found.pose[:2], pose[:2], atol=1e-4)
    if not ties:
        return
    elsewhere = 0
    for other, spread, _ in fits.values():
        delta = other - pose
        delta[2] = wrap_angle(delta[2])
        elsewhere += delta @ np.linalg.solve(covariance + spread, delta) >= gate(3, 0.99)
    assert found.ties == elsewhere and found.ambiguous == (elsewhere > 0)


def inside(seed: int, *, m: int = 10, true: int = 7, n: int = 60, keep: str = "dense") -> tuple[Array, Scan, Landmarks]:
    """A scan from inside a large map, and where it was taken."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 4.0 * np.sqrt(n), (n, 2))
    P = correlated(rng, places, 0.03, 0.02)
    mapped = places + (np.linalg.cholesky(P) @ rng.standard_normal(2 * n)).reshape(n, 2)
    pose = np.array([*(places.mean(0) + rng.uniform(-2, 2, 2)), rng.uniform(-np.pi, np.pi)])
    near = np.argsort(np.linalg.norm(places - pose[:2], axis=1))[: m + 2]
    seen = np.vstack([places[rng.permutation(near)[:true]], pose[:2] + rng.uniform(-8.0, 8.0, (m - true, 2))])
    points, noise = view(rng, pose, seen, 0.03)
    return pose, scan_of(points, noise), landmarks_of(mapped, P, keep=keep)
