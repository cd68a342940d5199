"""What the searches without a prior share beside the tree: the best hypotheses so far, and the answer."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.relocation.constraints import Path
from slam_gym.association.relocation.location import locate_pairings
from slam_gym.association.relocation.tree import (
    BINARY,
    JOINT,
    LEAVES,
    LIMIT,
    NODES,
    ORIENTATION,
    TRIES,
    UNARY,
    Problem,
)
from slam_gym.geometry import wrap_angle
from slam_gym.types import UNPAIRED, Array, Effort, IntArray, Relocation

_RIVALS = 256  # hypotheses with as many pairings as the best that are kept


class Best(NamedTuple):
    """The hypotheses with most pairings, all of them jointly compatible: those of equal number are rivals."""

    features: IntArray  # (r, m) map feature of each measurement, or UNPAIRED
    poses: Array  # (r, 3) [m, m, rad] in B
    covariances: Array  # (r, 3, 3)
    distances: Array  # (r,) D²
    state: IntArray  # (3,) number of pairings, of rivals, and which of them has the least D²


@compiled
def nothing_found(measurements: int) -> Best:
    """No hypothesis yet; one pairing is what any other must beat."""
    return Best(
        np.full((_RIVALS, measurements), UNPAIRED),
        np.empty((_RIVALS, 3)),
        np.empty((_RIVALS, 3, 3)),
        np.empty(_RIVALS),
        np.array([1, 0, 0]),
    )


@compiled
def offer(best: Best, problem: Problem, path: Path, k: int) -> bool:
    """Locate and test the hypothesis of k pairings, and keep it if it has as many as the best; whether it holds."""
    if k < 2:
        return False
    pose, covariance = np.empty(3), np.empty((3, 3))
    problem.effort[JOINT] += 1
    distance = locate_pairings(problem.scan.points, problem.scan.noise, problem.mapped, path, k, pose, covariance)
    if not distance < problem.joint_gates[k]:
        return False
    keep(best, path, k, pose, covariance, distance)
    return True


@compiled
def keep(best: Best, path: Path, k: int, pose: Array, covariance: Array, distance: float) -> None:
    """Enter a located hypothesis if it has as many pairings as the best and is not there yet."""
    state = best.state
    if k < state[0]:
        return
    if k > state[0]:
        state[0], state[1], state[2] = k, 0, 0
    for r in range(state[1]):
        same = True
        for a in range(k):
            same = same and best.features[r, path.measurements[a]] == path.features[a]
        if same:
            return
    least = state[1] == 0 or distance < best.distances[state[2]]
    if state[1] == _RIVALS and not least:
        return
    r = state[2] if state[1] == _RIVALS else state[1]
    state[1] = min(state[1] + 1, _RIVALS)
    best.features[r] = UNPAIRED
    for a in range(k):
        best.features[r, path.measurements[a]] = path.features[a]
    best.poses[r], best.covariances[r], best.distances[r] = pose, covariance, distance
    if least:
        state[2] = r


def answer_of(best: Best, problem: Problem, min_pairings: int, seconds: float) -> Relocation:
    """The rival with the least D², and how many of the others are elsewhere. All UNPAIRED and NaN if there is none.

    Two poses are one place when their difference δ is compatible with both covariances together,
    δᵀ(Σ_1 + Σ_2)⁻¹δ < χ²_3.
    """
    _, rivals, b = best.state.tolist()
    features, distance, ties = np.full(best.features.shape[1], UNPAIRED), 0.0, 0
    pose, covariance = np.full(3, math.nan), np.full((3, 3), math.nan)
    if rivals > 0:
        features, distance = best.features[b].copy(), float(best.distances[b])
        pose, covariance = best.poses[b].copy(), best.covariances[b].copy()
    if rivals > 1:
        apart, both = best.poses[:rivals] - pose, best.covariances[:rivals] + covariance
        apart[:, 2] = [wrap_angle(turn) for turn in apart[:, 2].tolist()]
        squares = np.einsum("ra,ra->r", apart, np.linalg.solve(both, apart[:, :, None])[:, :, 0])
        ties = int((squares >= problem.joint_gates[-1]).sum())
    counts = problem.effort.tolist()
    spent = Effort(
        nodes=counts[NODES],
        unary_tests=counts[UNARY],
        binary_tests=counts[BINARY],
        orientation_tests=counts[ORIENTATION],
        joint_tests=counts[JOINT],
        leaves=counts[LEAVES],
        tries=counts[TRIES],
        limit_hit=counts[LIMIT] > 0,
        seconds=seconds,
    )
    dof = max(2 * int((features != UNPAIRED).sum()) - 3, 0)
    return Relocation(features, pose, covariance, distance, dof, min_pairings, ties > 0, ties, spent)
