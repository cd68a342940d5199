"""Relocation below linear: a static hash of the triangles of near features, by their sides.

A triangle of features is written once, counterclockwise and longest side first: vertices A, B, C with sides
c = |AB| ≥ a = |BC|, b = |CA|. A mirror image runs clockwise, so it is found under other sides or not at all. Three
measurements are looked up by their distances; the triangles that agree imply poses, each of which is held against the
whole scan (`triangle_search`). The work is n times a small number (the chance that a triangle of the map looks like one
of the scan), not the number of pairs of pairings.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time

import numpy as np
from scipy.spatial import cKDTree

from slam_gym._jit import compiled
from slam_gym.association.acceptance import Crowding, least_pairings, log_expected
from slam_gym.association.acceptance import min_pairings as by_rule
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation.answer import answer_of
from slam_gym.association.relocation.arrays import Mapped, locality_arrays, map_arrays, scan_arrays
from slam_gym.association.relocation.constraints import difference_covariance, gates_at, measured
from slam_gym.association.relocation.location import locate
from slam_gym.association.relocation.tree import Problem, location_gates
from slam_gym.association.relocation.triangle_search import (
    FAR,
    Bytes,
    Floats32,
    Grid,
    Integers16,
    Integers32,
    Look,
    Raster,
    TriangleHash,
    cell_number,
    search,
)
from slam_gym.types import Array, IntArray, Landmarks, Locality, Relocation, Scan

_WITHIN = 23  # features within reach of each, more in small maps
_SAMPLE = 200  # features by whose surroundings the reach is judged
_TRIANGLES, _TRIANGLES_EACH = 40_000, 64  # at most: in any map, or for each feature
_NEAREST = 24  # features around each that its error is taken relative to, every other one of them
_POSES, _POSES_EACH = 20_000, 3  # of the default node limit: in any map, and for each feature
_DECISIVE = 0.002  # probability of pairings by chance so small that no rival of the same number is looked for
_FLOOR = 1e-10  # [m²] added to every variance of a feature, so that maps without errors have gates too
_RASTER_CELLS = 512  # for each feature, at most


class FeatureIndex:
    """A hash of the triangles in a map, for relocation.

    Triangles are hashed whose sides are within reach: so that each feature has some 23 others there and 64 triangles,
    or the map 40 000 of them. Raises ValueError as `map_arrays` does.
    """

    def __init__(self, landmarks: Landmarks) -> None:
        self.landmarks = landmarks
        independent = dataclasses.replace(
            landmarks,
            covariances=relative_covariances(landmarks) + _FLOOR * np.eye(2),
            covariance=np.empty((0, 0)),
            block_starts=np.empty(0, np.int64),
            block_columns=np.empty(0, np.int64),
            blocks=np.empty((0, 2, 2)),
        )
        self._mapped = map_arrays(independent)
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
        """The pose that explains most measurements, if it explains enough and no other explains as many.

        With `locality`, the other features are local to the first one paired. `min_pairings` defaults to the rule of
        `acceptance`, with densities in squares of 1.5 reach; what explains two less is not looked for. The
        search ends once no pose is unseen that explains as many measurements as the best. It also ends with one pairing
        more than needed, or with so many as chance brings once in 500 maps by the rule, where disjoint triples of what
        is paired have shown no other place that looks alike.

        `node_limit` bounds the nodes: poses verified, every location counting as 30. Default: 20 000 and 3 for each
        feature, some three times what it takes to refuse a scan of 20 measurements from elsewhere. Where it is met,
        `effort.limit_hit` says so, and the answer is what was found until then.

        Raises ValueError for a bad scan, a confidence outside (0, 1), fewer than 3 `min_pairings`, or a locality of
        another number of features.
        """
        began, seen, gates = time.perf_counter(), scan_arrays(scan), gates_at(confidence)
        decisive = len(scan) + 1
        if min_pairings is None:
            by_chance = log_expected(scan, self.landmarks, confidence=confidence, crowding=self._crowding)
            min_pairings, decisive = least_pairings(by_chance, 0.02), least_pairings(by_chance, _DECISIVE)
        if min_pairings < 3:
            raise ValueError(f"min_pairings: {min_pairings}; two pairings fit everywhere, so at least 3")
        if node_limit is None:
            node_limit = _POSES + _POSES_EACH * len(self)
        problem = Problem(
            measured(seen.points, seen.noise, gates),
            self._mapped,
            location_gates(len(scan), confidence),
            np.empty((0, 0), np.bool_),
            *locality_arrays(locality, len(self)),
            np.zeros(8, np.int64),
        )
        best = search(self._hash, Look(problem, seen, min_pairings, min(decisive, min_pairings + 1), node_limit))
        answer = answer_of(best, problem, min_pairings, time.perf_counter() - began)
        if answer.pairings and (len(self.landmarks.covariance) or len(self.landmarks.blocks)):
            located = locate(scan, self.landmarks, answer.features)
            pose, covariance, distance = located.pose, located.covariance, located.joint_distance
            answer = dataclasses.replace(answer, pose=pose, covariance=covariance, joint_distance=distance)
        return answer

    @functools.cached_property
    def _crowding(self) -> Crowding:
        """That of squares of 1.5 reach, with the mean variance of all features relative to those around."""
        positions, width = self._mapped.positions, 1.5 * self.reach
        others = cKDTree(positions).query_ball_point(positions, 0.5 * width, p=math.inf, return_length=True) - 1
        variance = 0.5 * float(np.trace(self._mapped.covariances, axis1=1, axis2=2).mean()) if len(self) else 0.0
        return Crowding(np.bincount(others), width * width, variance)


def indexed(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None = None,
    *,
    confidence: float = 0.99,
    min_pairings: int | None = None,
    node_limit: int | None = None,
) -> Relocation:
    """`FeatureIndex.relocate` in an index built for the occasion: for maps that are small, or looked up once."""
    if min_pairings is None:
        min_pairings = by_rule(scan, landmarks, confidence=confidence)
    return FeatureIndex(landmarks).relocate(
        scan, locality, confidence=confidence, min_pairings=min_pairings, node_limit=node_limit
    )


def relative_covariances(landmarks: Landmarks) -> Array:
    """Covariance of each feature relative to those around it, (n, 2, 2) [m²].

    The vector between features j and l has covariance D_jl = P_jj + P_ll − P_jl − P_lj, in which error that both share
    drops out. C_j is what makes D_jl ≈ C_j + C_l in the mean over near features l. Without cross-covariances it is
    P_jj. Raises ValueError as `map_arrays` does.
    """
    mapped, n = map_arrays(landmarks), len(landmarks)
    if n < 2 or (len(mapped.covariance) == 0 and len(mapped.blocks) == 0):
        return mapped.covariances.copy()
    near = cKDTree(mapped.positions).query(mapped.positions, k=min(_NEAREST + 1, n))[1][:, 1::2]
    differences = _differences(mapped, np.ascontiguousarray(near, np.int64))
    half = 0.5 * differences.mean(axis=1)
    relative = 2.0 * half - half[near].mean(axis=1)
    # Where the neighbours are known much worse, too little or nothing is left of C_j: half of the mean over D_jl is
    # taken instead, as if j and its neighbours were known equally well.
    enough = (relative[:, 0, 0] > 0.5 * half[:, 0, 0]) & (relative[:, 1, 1] > 0.5 * half[:, 1, 1])
    enough &= np.linalg.det(relative) > 0.0
    out: Array = np.where(enough[:, None, None], relative, half)
    out[:, [0, 1], [0, 1]] = np.maximum(out[:, [0, 1], [0, 1]], 0.0)
    return out


@compiled
def _differences(mapped: Mapped, near: IntArray) -> Array:
    """D_jl (n, k, 2, 2) [m²] of each feature and its neighbours (n, k)."""
    out = np.empty((*near.shape, 2, 2))
    for j in range(near.shape[0]):
        for p in range(near.shape[1]):
            xx, xy, yy = difference_covariance(mapped, j, near[j, p])
            out[j, p, 0, 0], out[j, p, 0, 1], out[j, p, 1, 0], out[j, p, 1, 1] = xx, xy, xy, yy
    return out


def _usual_reach(positions: Array) -> float:
    """[m] what gives each feature enough others within reach; 11 m where there are fewer than three features."""
    n = len(positions)
    if n < 3:
        return 11.0
    near = min(int(_WITHIN * math.sqrt(_most_triangles(n) / (_TRIANGLES_EACH * n))), n - 1)
    distances = cKDTree(positions).query(positions[:: max(n // _SAMPLE, 1)], k=near + 1)[0]
    return max(float(np.median(distances[:, near])), 1e-3)


def _most_triangles(n: int) -> int:
    return max(_TRIANGLES_EACH * n, _TRIANGLES)


def _hash_of(mapped: Mapped) -> TriangleHash:
    """The hash of a map whose covariances are relative to the features around."""
    positions, spreads, n = mapped.positions, mapped.covariances, len(mapped.positions)
    reach, most = _usual_reach(positions), _most_triangles(len(positions))
    widest = np.linalg.eigvalsh(spreads)[:, 1].astype(np.float64)
    noise = math.sqrt(float(np.median(np.trace(spreads, axis1=1, axis2=2))) + 1e-6) if n else 0.07
    noise = max(noise, reach / 400.0)
    reach, neighbours = _neighbours(positions, reach)
    quantum = max(5.0 * noise, reach / 32.0)
    cells, corners, sides = _triangles(mapped, neighbours, quantum, reach, most)
    while len(cells) > most:
        reach, neighbours = _neighbours(positions, 0.9 * reach)
        cells, corners, sides = _triangles(mapped, neighbours, quantum, reach, most)
    order = np.argsort(cells, kind="stable")
    starts = np.searchsorted(cells[order], np.arange(cell_number(math.floor(reach / quantum) + 1, 0, 0) + 1))
    grid, raster = _grid_of(positions, reach / 7.0), _raster_of(positions, widest, 3.5 * noise)
    largest = float(widest.max(initial=_FLOOR))
    return TriangleHash(starts, corners[order], sides[order], grid, raster, reach, quantum, largest)


def _neighbours(positions: Array, reach: float) -> tuple[float, tuple[IntArray, IntArray]]:
    """Features later than each and within reach of it, (n + 1,) starts and (e,); the reach is less where they crowd."""
    n, tree = len(positions), cKDTree(positions)
    while n and tree.count_neighbors(tree, reach) > 4 * _WITHIN * _most_triangles(n) / _TRIANGLES_EACH:
        reach *= 0.9
    pairs = tree.query_pairs(reach, output_type="ndarray").astype(np.int64)
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    return reach, (np.searchsorted(pairs[:, 0], np.arange(n + 1)), np.ascontiguousarray(pairs[:, 1]))


@compiled
def _triangles(
    mapped: Mapped, neighbours: tuple[IntArray, IntArray], quantum: float, reach: float, most: int
) -> tuple[Integers16, Integers32, Floats32]:
    """Cell, corners and sides of each triangle; not of all where they are more than `most`, but of one more."""
    positions, spreads, (starts, later), count = mapped.positions, mapped.covariances, neighbours, 0
    cells, corners = np.empty(most + 1, np.int16), np.empty((most + 1, 3), np.int32)
    sides, numbers, lengths = np.empty((most + 1, 4), np.float32), np.empty(3, np.int64), np.empty(3)
    for f in range(len(positions)):
        for p in range(starts[f], starts[f + 1]):
            for q in range(starts[f], p):
                j, l = later[q], later[p]
                (fx, fy), (jx, jy), (lx, ly) = positions[f], positions[j], positions[l]
                if (jx - lx) ** 2 + (jy - ly) ** 2 > reach * reach or count > most:
                    continue
                if (jx - fx) * (ly - fy) - (jy - fy) * (lx - fx) < 0.0:
                    j, l = l, j
                numbers[0], numbers[1], numbers[2] = f, j, l
                for k in range(3):
                    a, b = numbers[k], numbers[(k + 1) % 3]
                    lengths[k] = math.hypot(positions[b, 0] - positions[a, 0], positions[b, 1] - positions[a, 1])
                first, variance = int(np.argmax(lengths)), 0.0
                longest, second, third = lengths[first], lengths[(first + 1) % 3], lengths[(first + 2) % 3]
                cells[count] = cell_number(int(longest / quantum), int(second / quantum), int(third / quantum))
                for side in range(3):
                    a, b = numbers[(first + side) % 3], numbers[(first + side + 1) % 3]
                    x, y = positions[b, 0] - positions[a, 0], positions[b, 1] - positions[a, 1]
                    xx, yy = spreads[a, 0, 0] + spreads[b, 0, 0], spreads[a, 1, 1] + spreads[b, 1, 1]
                    xy = spreads[a, 0, 1] + spreads[b, 0, 1]
                    corners[count, side], sides[count, side] = a, lengths[(first + side) % 3]
                    square = x * x + y * y
                    along = (x * x * xx + 2.0 * x * y * xy + y * y * yy) / square if square > 0.0 else xx + yy
                    variance = max(variance, along)
                sides[count, 3] = variance
                count += 1
    return cells[:count], corners[:count], sides[:count]


def _grid_of(positions: Array, side: float) -> Grid:
    """Cells of `side` [m], or more where they would be too many for so few features."""
    low, high = positions.min(axis=0, initial=math.inf), positions.max(axis=0, initial=-math.inf)
    if not len(positions):
        low = high = np.zeros(2)
    side = _coarse_enough(high - low, side, 8 * len(positions))
    columns, rows = (math.floor(extent / side) + 1 for extent in (high - low).tolist())
    cells = np.floor((positions - low) / side).astype(np.int64)
    numbers = cells[:, 1] * columns + cells[:, 0]
    starts = np.concatenate(([0], np.cumsum(np.bincount(numbers, minlength=rows * columns))))
    origin = (float(low[0]), float(low[1]), side)
    return Grid(starts, np.argsort(numbers, kind="stable"), (rows, columns), origin)


def _coarse_enough(extent: Array, side: float, cells: int) -> float:
    """[m] `side`, or so much more that no more than about so many `cells` cover an `extent` (2,) [m]."""
    while (extent[0] / side + 1.0) * (extent[1] / side + 1.0) > cells + 1024:
        side *= 1.25
    return side


def _raster_of(positions: Array, widest: Array, side: float) -> Raster:
    """Cells of `side` [m], or more where they would be too many; distances up to six of them are told."""
    if not len(positions):
        return Raster(np.full((1, 1), FAR, np.uint8), (0.0, 0.0, side), side)
    gate = chi2_gate(2, 0.99)
    low, high = positions.min(axis=0), positions.max(axis=0)
    side = _coarse_enough(high - low, side, _RASTER_CELLS * len(positions))
    step = 7.0 * side / FAR
    margin = math.hypot(7.0 * side, math.sqrt(gate * float(widest.max()))) + 2.0 * side
    margin = min(margin, 8.0 * side + float((high - low).max()))
    columns, rows = (math.floor((extent + 2.0 * margin) / side) + 1 for extent in (high - low).tolist())
    steps, origin = np.full((rows, columns), FAR, np.uint8), (float(low[0] - margin), float(low[1] - margin), side)
    _paint(steps, origin, step, positions, gate * widest)
    return Raster(steps, origin, step)


@compiled
def _paint(steps: Bytes, origin: tuple[float, float, float], step: float, positions: Array, explained: Array) -> None:
    """Enter the distances of all features, of which `explained` (n,) [m²] of the squares is their own uncertainty."""
    (rows, columns), (left, bottom, side), furthest = steps.shape, origin, (FAR * step) ** 2
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
