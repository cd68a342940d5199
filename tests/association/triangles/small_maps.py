"""Maps and scans drawn at random, small enough to be gone through by brute force, for the tests of the index."""

import itertools
import math

import numpy as np

from slam_gym.association.triangles.arguments import search_gates
from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.association.triangles.pose import Look, Store
from slam_gym.geometry import observe
from slam_gym.types import SPURIOUS, Array, Landmarks, Relocation, Scan

SIGMA = 0.05


def landmarks_at(positions: Array, sigma: float = SIGMA, covariance: Array | None = None) -> Landmarks:
    if covariance is None:
        return Landmarks.from_points(positions, sigma=sigma)
    return Landmarks.from_points(positions, covariance=covariance)


def scan_at(points: Array, sigma: float = SIGMA) -> Scan:
    return Scan.from_points(points, sigma=sigma)


def field(rng: np.random.Generator, n: int) -> Array:
    """n features at 1/16 per m²."""
    return rng.uniform(0.0, 4.0 * math.sqrt(n), (n, 2))


def view(
    rng: np.random.Generator, truth: Array, m: int, spurious: int, sigma: float = SIGMA, half: bool = False
) -> tuple[Scan, Array, Array]:
    """A scan from a random place, its pose, and the feature behind each measurement."""
    seen = m - spurious
    pose = np.array([*rng.uniform(0.2, 0.8, 2) * truth.max(0), rng.uniform(-np.pi, np.pi)])
    near = np.argsort(np.hypot(*(truth - pose[:2]).T))[: 2 * seen if half else seen]
    sources = np.concatenate([rng.permutation(near)[:seen], np.full(spurious, SPURIOUS)])
    radius = np.hypot(*(truth[near[-1]] - pose[:2])) * np.sqrt(rng.random(spurious))
    angle = rng.uniform(-np.pi, np.pi, spurious)
    points = np.concatenate(
        [observe(pose, truth[sources[:seen]]), np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])]
    )
    order = rng.permutation(m)
    return scan_at(points[order] + sigma * rng.standard_normal((m, 2)), sigma), pose, sources[order]


def is_near(answer: Relocation, pose: Array) -> bool:
    turn = (answer.pose[2] - pose[2] + np.pi) % (2 * np.pi) - np.pi
    return bool(np.hypot(*(answer.pose[:2] - pose[:2])) < 0.3 and abs(turn) < math.radians(3.0))


def assert_same(a: Relocation, b: Relocation) -> None:
    assert np.array_equal(a.features, b.features) and a.ties == b.ties and a.min_pairings == b.min_pairings
    np.testing.assert_array_equal(a.pose, b.pose)


def store_of(index: FeatureIndex) -> Store:
    return Store(*index._store())


def look_at(scan: Scan, confidence: float = 0.99) -> Look:
    """The scan as the kernels take it, without sizes, kinds and localities."""
    R, none = scan.covariances, np.empty(0, np.int64)
    noise = np.column_stack([R[:, 0, 0], R[:, 0, 1], R[:, 1, 1]])
    widest = np.linalg.eigvalsh(R)[:, 1]
    gates = search_gates(len(scan), confidence)
    return Look(scan.points, noise, np.full((len(scan), 3), np.nan), widest, gates, none, none)


def triangles_within(positions: Array, reach: float) -> set[frozenset[int]]:
    """All triples of features no two of which are farther apart than `reach`, by brute force."""
    apart = np.hypot(*(positions[:, None] - positions[None]).transpose(2, 0, 1))
    triples = itertools.combinations(range(len(positions)), 3)
    return {frozenset(t) for t in triples if max(apart[i, j] for i, j in itertools.combinations(t, 2)) <= reach}
