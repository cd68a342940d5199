"""The input of a search without a prior, its best hypotheses, and its answer."""

import functools
import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from slam_gym._jit import compiled, inlined
from slam_gym.association.acceptance import min_pairings as required_pairings
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation import constraints
from slam_gym.association.relocation.constraints import Mapped, Measured, Path, relative_to_neighbours
from slam_gym.association.relocation.location import locate_pairings
from slam_gym.geometry import wrap_angles
from slam_gym.types import UNPAIRED, Array, BoolArray, Effort, IntArray, Landmarks, Locality, Relocation, Scan

LOCATION_LIMIT = 5_000  # hypotheses that a search locates, a quarter of a second for scans of ten
TEST_LIMIT = 40_000_000  # tests of constraints in a search, which take half a second to several
_ORIENTATION_COST = 40  # tests that one of the orientation counts for: most candidates fail before it
_RIVALS = 256  # maximum number of hypotheses kept with as many pairings as the best


class EffortIndex(NamedTuple):
    """Index of each count in `Problem.effort`, named as in `Effort`."""

    nodes: int = 0
    unary_tests: int = 1
    binary_tests: int = 2
    orientation_tests: int = 3
    leaves: int = 4
    joint_tests: int = 5
    tries: int = 6
    limit_hit: int = 7  # 1 where a limit ended the search


INDEX = EffortIndex()


class Problem(NamedTuple):
    """A scan, a map and a locality, as the compiled searches take them, and the work done so far."""

    scan: Measured
    mapped: Mapped
    joint_gates: Array  # (m + 2,) `location_gates`
    allowed: BoolArray  # (m, n) table of the unary constraints; (0, 0): they are tested when needed
    starts: IntArray  # (n + 1,) L(j) is members[starts[j]:starts[j + 1]]; both empty where all are local to all
    members: IntArray
    effort: IntArray  # (8,) see `EffortIndex`


class Best(NamedTuple):
    """The jointly compatible hypotheses with the most pairings. They are rivals."""

    features: IntArray  # (r, m) map feature of each measurement, or UNPAIRED
    poses: Array  # (r, 3) [m, m, rad] in B
    covariances: Array  # (r, 3, 3)
    distances: Array  # (r,) D²
    state: IntArray  # (3,) number of pairings, number of rivals, and index of the rival with the least D²


@functools.lru_cache(maxsize=256)
def location_gates(pairings: int, confidence: float) -> Array:
    """χ²_{2k−3,conf} for k = 0 … pairings, inf for k < 2; then χ²_{3,conf}, for a pose. Shape (pairings + 2,)."""
    gates = [math.inf if k < 2 else chi2_gate(2 * k - 3, confidence) for k in range(pairings + 1)]
    return np.array([*gates, chi2_gate(3, confidence)])


def problem_of(
    scan: Scan, mapped: Mapped, locality: Locality | None, confidence: float, *, tabulate: bool = True
) -> Problem:
    """The input of a search without a prior. Raises ValueError for bad numbers in scan or locality."""
    seen = constraints.measured(constraints.scan_arrays(scan), confidence)
    members = constraints.locality_arrays(locality, len(mapped.positions))
    table = constraints.unary_table(seen[2:5], mapped[2:5], seen.gate_one) if tabulate else np.empty((0, 0), np.bool_)
    return Problem(seen, mapped, location_gates(len(scan), confidence), table, *members, np.zeros(len(INDEX), np.int64))


def searched(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None,
    confidence: float,
    min_pairings: int | None,
    search: Callable[[Problem, Best], None],
) -> Relocation:
    """The answer of a `search` that enters its hypotheses in a `Best`.

    No hypothesis with fewer than `min_pairings` is looked for; None: any, and the rule of `acceptance` judges the
    answer. Raises ValueError as `map_arrays` and `problem_of`, and for `min_pairings` below 2, which leave the pose
    undetermined.
    """
    if min_pairings is not None and min_pairings < 2:
        raise ValueError(f"min_pairings: {min_pairings} is less than 2")
    began, problem = time.perf_counter(), problem_of(scan, constraints.map_arrays(landmarks), locality, confidence)
    best = nothing_found(len(scan), min_pairings)
    search(problem, best)
    if min_pairings is None:
        min_pairings = required_pairings(scan, landmarks, confidence=confidence)
    return answer_of(best, problem, min_pairings, time.perf_counter() - began)


def nothing_found(measurements: int, least: int | None = None) -> Best:
    """An empty `Best`, which only hypotheses of at least two pairings, and of at least `least`, can beat."""
    return Best(
        np.full((_RIVALS, measurements), UNPAIRED),
        np.empty((_RIVALS, 3)),
        np.empty((_RIVALS, 3, 3)),
        np.empty(_RIVALS),
        np.array([max(least or 2, 2) - 1, 0, 0]),
    )


@inlined
def must_end(effort: IntArray, node_limit: int) -> bool:
    """Whether a limit of a search through the interpretation tree is reached; then enters that in `effort`."""
    tests = effort[INDEX.unary_tests] + effort[INDEX.binary_tests] + _ORIENTATION_COST * effort[INDEX.orientation_tests]
    if effort[INDEX.nodes] >= node_limit or effort[INDEX.joint_tests] >= LOCATION_LIMIT or tests >= TEST_LIMIT:
        effort[INDEX.limit_hit] = 1
    return bool(effort[INDEX.limit_hit] == 1)


@inlined
def fewest(best: Best, rivals: bool) -> int:
    """The least number of pairings worth keeping: more than the best has, or with `rivals` as many."""
    return int(best.state[0] + (best.state[1] == 0 or not rivals))


@compiled
def joint_distance(problem: Problem, path: Path, k: int, pose: Array, covariance: Array) -> float:
    """D² of the first k pairings of a path, at their best pose; inf unless they are jointly compatible and at least
    two.

    `pose` (3,) and `covariance` (3, 3) are written.
    """
    if k < 2:
        return math.inf
    problem.effort[INDEX.joint_tests] += 1
    distance = locate_pairings(problem.scan.points, problem.scan.noise, problem.mapped, path, k, pose, covariance)
    return distance if distance < problem.joint_gates[k] else math.inf


@compiled
def offer(best: Best, problem: Problem, path: Path, k: int) -> bool:
    """Locate the hypothesis of k pairings, and keep it if it is jointly compatible and has as many as the best. Returns
    whether it is compatible."""
    pose, covariance = np.empty(3), np.empty((3, 3))
    distance = joint_distance(problem, path, k, pose, covariance)
    if distance < math.inf:
        keep(best, path, k, pose, covariance, distance)
    return distance < math.inf


@compiled
def keep(best: Best, path: Path, k: int, pose: Array, covariance: Array, distance: float) -> None:
    """Keep a located hypothesis if it has as many pairings as the best and is not a duplicate."""
    state = best.state
    if k < state[0]:
        return
    if k > state[0]:
        state[0], state[1], state[2] = k, 0, 0
    features = np.full(best.features.shape[1], UNPAIRED)
    features[path.measurements[:k]] = path.features[:k]
    for r in range(state[1]):
        if (best.features[r] == features).all():
            return
    least = state[1] == 0 or distance < best.distances[state[2]]
    if state[1] == _RIVALS and not least:
        return
    r = state[2] if state[1] == _RIVALS else state[1]
    state[1] = min(state[1] + 1, _RIVALS)
    best.features[r], best.poses[r], best.covariances[r], best.distances[r] = features, pose, covariance, distance
    if least:
        state[2] = r


def keep_largest(best: Best, problem: Problem, hypotheses: list[Path]) -> None:
    """Enter the `hypotheses` in `best`; if none is jointly compatible, those that remain after dropping pairings."""
    for path in hypotheses:
        problem.effort[INDEX.leaves] += 1
        offer(best, problem, path, len(path.features))
    for path in [] if best.state[1] > 0 else hypotheses:
        if problem.effort[INDEX.joint_tests] >= LOCATION_LIMIT:
            problem.effort[INDEX.limit_hit] = 1
            break
        while (k := len(path.features)) >= fewest(best, True) and not offer(best, problem, path, k):
            path = _without_worst(problem, path)


def _without_worst(problem: Problem, path: Path) -> Path:
    """The path without the pairing whose removal leaves the least D²."""
    scan, k, pose, covariance = problem.scan, len(path.features) - 1, np.empty(3), np.empty((3, 3))
    rests = [Path(np.delete(path.measurements, a), np.delete(path.features, a)) for a in range(k + 1)]
    problem.effort[INDEX.joint_tests] += len(rests)
    distances = [locate_pairings(scan.points, scan.noise, problem.mapped, rest, k, pose, covariance) for rest in rests]
    return rests[int(np.nan_to_num(distances, nan=math.inf).argmin())]


def answer_of(best: Best, problem: Problem, min_pairings: int, seconds: float) -> Relocation:
    """The rival with the least D², and the number of others at another pose. All UNPAIRED and NaN if there is none."""
    _, rivals, b = best.state.tolist()
    features, distance, ties = np.full(best.features.shape[1], UNPAIRED), 0.0, 0
    pose, covariance = np.full(3, math.nan), np.full((3, 3), math.nan)
    if rivals > 0:
        features, distance = best.features[b].copy(), float(best.distances[b])
        pose, covariance, ties = best.poses[b].copy(), best.covariances[b].copy(), _elsewhere(best, problem)
    counts: dict[str, Any] = dict(zip(INDEX._fields, problem.effort.tolist(), strict=True))
    spent = Effort(**counts | {"limit_hit": counts["limit_hit"] > 0, "seconds": seconds})
    dof = max(2 * int((features != UNPAIRED).sum()) - 3, 0)
    return Relocation(features, pose, covariance, distance, dof, min_pairings, ties > 0, ties, spent)


def _elsewhere(best: Best, problem: Problem) -> int:
    """The number of rivals whose pose is another than that of the best one.

    Two poses are the same where their difference δ fits the sum of their covariances: δᵀ(Σ_1 + Σ_2)⁻¹δ < χ²_3. The
    error of the whole map moves both alike: poses and covariances are those relative to neighbouring features.
    """
    _, rivals, b = best.state.tolist()
    poses, covariances = best.poses[:rivals].copy(), best.covariances[:rivals].copy()
    if rivals > 1 and len(problem.mapped.covariance) + len(problem.mapped.blocks) > 0:
        mapped = relative_to_neighbours(problem.mapped)
        for features, pose, covariance in zip(best.features, poses, covariances):
            paired = np.flatnonzero(features != UNPAIRED)
            path = Path(paired, features[paired])
            locate_pairings(problem.scan.points, problem.scan.noise, mapped, path, len(paired), pose, covariance)
    differences, sums = poses - poses[b], covariances + covariances[b]
    differences[:, 2] = wrap_angles(differences[:, 2])
    squares = np.einsum("ra,ra->r", differences, np.linalg.solve(sums, differences[:, :, None])[:, :, 0])
    return int((squares >= problem.joint_gates[-1]).sum())
