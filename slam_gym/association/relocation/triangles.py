"""Relocation by a static hash of the triangles of nearby features, by their sides.

Each triangle of features is stored once, counterclockwise and longest side first: vertices A, B, C with sides c = |AB|
≥ a = |BC|, b = |CA|. Its mirror image runs clockwise, and so has other sides or is not stored. Three measurements are
looked up by their distances. The matching triangles imply poses, each of which is tested against the whole scan
(`triangle_search`). The work is n times a small number (the probability that a triangle of the map is similar to one of
the scan), instead of the number of pairs of pairings.
"""

import functools
import math
import time

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slam_gym._jit import compiled
from slam_gym.association.acceptance import Crowding, crowding_of
from slam_gym.association.acceptance import min_pairings as required_pairings
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation.constraints import Mapped, Path, map_arrays, relative_to_neighbours, unchecked_map
from slam_gym.association.relocation.problem import answer_of, keep_largest, nothing_found, problem_of
from slam_gym.association.relocation.triangle_search import FAR, FeatureCells, Raster, TriangleHash, cell_number, search
from slam_gym.types import UNPAIRED, Array, IntArray, Landmarks, Locality, Relocation, Scan
from slam_gym.validation import check_count

_WITHIN = 23  # features within reach of each feature; more in small maps
_SAMPLE = 200  # features sampled to determine the reach
_LEAST_REACH = 1e-3  # [m]
_TRIANGLES, _TRIANGLES_EACH = 40_000, 64  # maximum in any map, or for each feature
_POSES, _POSES_EACH = 20_000, 3  # of the default node limit: in any map, and for each feature
_LEAST_VARIANCE = 1e-10  # [m²] of the least certain feature, in a map without features
_RASTER_CELLS = 512  # maximum for each feature


class FeatureIndex:
    """A hash of the triangles in a map, for relocation.

    Triangles are hashed if their sides are within reach. The reach is such that each feature has some 23 others within
    it and 64 triangles, or the map has 40 000. Raises ValueError as `map_arrays` does.
    """

    def __init__(self, landmarks: Landmarks) -> None:
        self.landmarks = landmarks
        self._mapped = relative_to_neighbours(map_arrays(landmarks))
        self._hash = _hash_of(self._mapped)

    def __len__(self) -> int:
        return len(self.landmarks)

    @property
    def reach(self) -> float:
        """[m] longest side of the triangles hashed."""
        return self._hash.reach

    def relocate(
        self,
        scan: Scan,
        locality: Locality | None = None,
        *,
        confidence: float = 0.99,
        min_pairings: int | None = None,
        node_limit: int | None = None,
    ) -> Relocation:
        """The pose that explains most measurements, if it explains enough and no other pose explains as many.

        With `locality`, the other features are local to the first one paired. `min_pairings` defaults to the rule of
        `acceptance`, with densities in squares of 1.5 reach; hypotheses with two pairings less are not searched. The
        search ends once no pose that explains as many measurements as needed can be missed. It also ends with one
        pairing more, once disjoint triples of the paired measurements have shown no other similar place.

        `node_limit` bounds the nodes, which are the poses verified; every location counts as 30. Default: 20 000 plus 3
        for each feature, some three times what it takes to reject a scan of 20 measurements from elsewhere. Where it is
        reached, `effort.limit_hit` is set, and the answer is the best found so far.

        Raises ValueError for a bad scan, a confidence outside (0, 1), fewer than 3 `min_pairings`, a node limit
        below 1, or a locality of another number of features.
        """
        began = time.perf_counter()
        if min_pairings is None:
            min_pairings = required_pairings(scan, self.landmarks, confidence=confidence, crowding=self._crowding)
        if min_pairings < 3:
            raise ValueError(f"min_pairings: {min_pairings}; two pairings fit everywhere, so at least 3")
        if node_limit is None:
            node_limit = _POSES + _POSES_EACH * len(self)
        check_count("node_limit", node_limit)
        problem = problem_of(scan, self._mapped, locality, confidence, tabulate=False)
        best = nothing_found(len(scan))
        search(self._hash, problem, min_pairings, node_limit, best)
        if len(self.landmarks.covariance) or len(self.landmarks.blocks):  # the joint test with all covariances
            paired = [(features != UNPAIRED).nonzero()[0] for features in best.features[: best.state[1]]]
            paths = [Path(of_scan, features[of_scan]) for of_scan, features in zip(paired, best.features)]
            problem, best = problem._replace(mapped=unchecked_map(self.landmarks)), nothing_found(len(scan))
            keep_largest(best, problem, paths)
        return answer_of(best, problem, min_pairings, time.perf_counter() - began)

    @functools.cached_property
    def _crowding(self) -> Crowding:
        """The crowding of the map in squares of 1.5 reach."""
        return crowding_of(self.landmarks, 1.5 * self.reach)


def indexed(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None = None,
    *,
    confidence: float = 0.99,
    min_pairings: int | None = None,
    node_limit: int | None = None,
) -> Relocation:
    """`FeatureIndex.relocate` in a temporary index: for small maps, or for a single query."""
    if min_pairings is None:
        min_pairings = required_pairings(scan, landmarks, confidence=confidence)
    return FeatureIndex(landmarks).relocate(
        scan, locality, confidence=confidence, min_pairings=min_pairings, node_limit=node_limit
    )


def _hash_of(mapped: Mapped) -> TriangleHash:
    """The hash of a map whose covariances are relative to the neighbouring features."""
    positions, n = mapped.positions, len(mapped.positions)
    tree, most = cKDTree(positions), max(_TRIANGLES_EACH * n, _TRIANGLES)
    reach = _usual_reach(tree, most)
    widest = np.linalg.eigvalsh(mapped.covariances)[:, 1].astype(np.float64)
    noise = math.sqrt(float(np.median(np.trace(mapped.covariances, axis1=1, axis2=2))) + 1e-6) if n else 0.07
    noise = max(noise, reach / 400.0)
    quantum = max(5.0 * noise, reach / 32.0)
    while True:  # reduce the reach where features are dense
        is_least = reach < _LEAST_REACH  # features at one place have as many triangles within any reach
        if n == 0 or is_least or tree.count_neighbors(tree, reach) <= 4 * _WITHIN * most / _TRIANGLES_EACH:
            cells, corners, sides = _triangles(mapped, _neighbours(tree, reach), quantum, reach, most)
            if len(cells) <= most or is_least:
                break
        reach *= 0.9
    order = np.argsort(cells, kind="stable")
    starts = np.searchsorted(cells[order], np.arange(cell_number(math.floor(reach / quantum) + 1, 0, 0) + 1))
    grid, raster = _grid_of(positions, reach / 7.0), _raster_of(positions, widest, 3.5 * noise)
    largest = min(float(widest.max(initial=_LEAST_VARIANCE)), 16.0 * noise * noise)  # few must not widen all gates
    return TriangleHash(starts, corners[order], sides[order], grid, raster, reach, quantum, largest)


def _usual_reach(tree: cKDTree, most: int) -> float:
    """[m] distance within which each feature has enough others; 11 m for fewer than three features."""
    if tree.n < 3:
        return 11.0
    near = min(int(_WITHIN * math.sqrt(most / (_TRIANGLES_EACH * tree.n))), tree.n - 1)
    distances = tree.query(tree.data[:: max(tree.n // _SAMPLE, 1)], k=near + 1)[0]
    return max((1.0 + 1e-6) * float(np.median(distances[:, near])), _LEAST_REACH)  # rounding must lose no triangle


def _neighbours(tree: cKDTree, reach: float) -> tuple[IntArray, IntArray]:
    """For each feature, the later ones within reach of it: starts (n + 1,) and members (e,)."""
    pairs = tree.query_pairs(reach, output_type="ndarray").astype(np.int64)
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    return np.searchsorted(pairs[:, 0], np.arange(tree.n + 1)), np.ascontiguousarray(pairs[:, 1])


@compiled
def _triangles(
    mapped: Mapped, neighbours: tuple[IntArray, IntArray], quantum: float, reach: float, most: int
) -> tuple[NDArray[np.int16], NDArray[np.int32], NDArray[np.float32]]:
    """Cell, corners and sides of each triangle. If there are more than `most`, only `most` + 1 of them."""
    F, P, (starts, later), count = mapped.positions, mapped.covariances, neighbours, 0
    cells, corners = np.empty(most + 1, np.int16), np.empty((most + 1, 3), np.int32)
    sides, ordered, lengths = np.empty((most + 1, 4), np.float32), np.empty(3, np.int64), np.empty(3)
    for f in range(len(F)):
        for p in range(starts[f], starts[f + 1]):
            for q in range(starts[f], p):
                j, l = later[q], later[p]
                if (F[j, 0] - F[l, 0]) ** 2 + (F[j, 1] - F[l, 1]) ** 2 > reach * reach or count > most:
                    continue
                area = (F[j, 0] - F[f, 0]) * (F[l, 1] - F[f, 1]) - (F[j, 1] - F[f, 1]) * (F[l, 0] - F[f, 0])
                ordered[0], ordered[1], ordered[2], variance = f, j if area >= 0.0 else l, l if area >= 0.0 else j, 0.0
                for k in range(3):
                    a, b = ordered[k], ordered[(k + 1) % 3]
                    x, y = F[b, 0] - F[a, 0], F[b, 1] - F[a, 1]
                    xx, xy, yy = P[a, 0, 0] + P[b, 0, 0], P[a, 0, 1] + P[b, 0, 1], P[a, 1, 1] + P[b, 1, 1]
                    square = x * x + y * y
                    lengths[k] = math.sqrt(square)
                    side_variance = (x * x * xx + 2.0 * x * y * xy + y * y * yy) / square if square > 0.0 else xx + yy
                    variance = max(variance, side_variance)
                first = int(np.argmax(lengths))
                for k in range(3):
                    corners[count, k], sides[count, k] = ordered[(first + k) % 3], lengths[(first + k) % 3]
                sides[count, 3] = variance
                c, a, b = lengths[first], lengths[(first + 1) % 3], lengths[(first + 2) % 3]
                cells[count] = cell_number(int(c / quantum), int(a / quantum), int(b / quantum))
                count += 1
    return cells[:count], corners[:count], sides[:count]


def _coarse_enough(positions: Array, side: float, most: int) -> tuple[float, Array, Array]:
    """[m] `side`, enlarged until about `most` cells per position cover the area; and the corners (2,) of the area."""
    low, high = (positions.min(axis=0), positions.max(axis=0)) if len(positions) else np.zeros((2, 2))
    while np.prod((high - low) / side + 1.0) > most * len(positions) + 1024:
        side *= 1.25
    return side, low, high


def _grid_of(positions: Array, side: float) -> FeatureCells:
    """The grid of cells of `side` [m], enlarged where these would be too many for so few features."""
    side, low, high = _coarse_enough(positions, side, 8)
    columns, rows = (math.floor(extent / side) + 1 for extent in (high - low).tolist())
    cells = np.floor((positions - low) / side).astype(np.int64)
    numbers = cells[:, 1] * columns + cells[:, 0]
    starts = np.concatenate(([0], np.cumsum(np.bincount(numbers, minlength=rows * columns))))
    return FeatureCells(
        starts, np.argsort(numbers, kind="stable"), (rows, columns), (float(low[0]), float(low[1]), side)
    )


def _raster_of(positions: Array, widest: Array, side: float) -> Raster:
    """The raster, of cells of `side` [m] or more where these would be too many. It reaches as far as seven cells."""
    side, low, high = _coarse_enough(positions, side, _RASTER_CELLS)
    step, (left, bottom) = 7.0 * side / FAR, (low - 9.0 * side).tolist()
    columns, rows = (math.floor(extent / side) + 19 for extent in (high - low).tolist())
    raster = Raster(np.full((rows, columns), FAR, np.uint8), (left, bottom, side), step)
    _paint(raster, positions, chi2_gate(2, 0.99) * widest)
    return raster


@compiled
def _paint(raster: Raster, positions: Array, explained: Array) -> None:
    """Write the distances to all features; `explained` (n,) [m²] of their squares is the features' own uncertainty."""
    steps, (left, bottom, side), step = raster
    (rows, columns), furthest = steps.shape, (FAR * step) ** 2
    for j in range(len(positions)):
        x, y, radius = positions[j, 0], positions[j, 1], math.sqrt(furthest + explained[j])
        for row in range(max(int((y - radius - bottom) / side), 0), min(int((y + radius - bottom) / side) + 1, rows)):
            dy = max(row * side + bottom - y, y - bottom - (row + 1) * side, 0.0)
            first, last = max(int((x - radius - left) / side), 0), min(int((x + radius - left) / side) + 1, columns)
            for column in range(first, last):
                dx = max(column * side + left - x, x - left - (column + 1) * side, 0.0)
                square = dx * dx + dy * dy - explained[j]
                if square < furthest:
                    steps[row, column] = min(steps[row, column], int(math.sqrt(max(square, 0.0)) / step))
