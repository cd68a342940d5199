"""GCBB: geometric constraints branch and bound (Neira, Tardós and Castellanos, ICRA 2003), with locality."""

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.relocation.constraints import Path
from slam_gym.association.relocation.problem import INDEX, Best, Problem, fewest, must_end, offer, searched
from slam_gym.association.relocation.tree import next_branch
from slam_gym.types import UNPAIRED, Landmarks, Locality, Relocation, Scan
from slam_gym.validation import check_count

_STAR = -1  # in place of a candidate: `*` comes next, no candidates are left


def gcbb(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None = None,
    *,
    confidence: float = 0.99,
    min_pairings: int | None = None,
    node_limit: int = 1_000_000,
    rivals: bool = True,
) -> Relocation:
    """The jointly compatible hypothesis with most pairings among those that satisfy location-independent constraints.

    The search is depth first through the interpretation tree; level i decides measurement i. A feature is a legal
    branch where three conditions hold: the unary constraint, the binary one with every pairing already made, and the
    same orientation with the first pairing and every other one. `*` comes last. After the first pairing only features
    local to its feature are offered. A node is visited if pairings so far + levels left > pairings of the best. A leaf
    that may beat the best is located, and accepted if D² < χ²_{2k−3}.

    With `rivals`, nodes that may equal the best are visited too. The hypothesis with most pairings and least D² is then
    returned, and `ties` is the number of the others that imply another pose. Without, the search is that of the paper:
    the first hypothesis with most pairings is returned, and ties are not counted.

    `min_pairings` replaces the rule of `acceptance`, and no hypothesis with fewer is looked for. Where `node_limit`,
    `LOCATION_LIMIT` or `TEST_LIMIT` ends the search, `effort.limit_hit` is set and the best hypothesis so far is
    returned. Raises ValueError for a node limit below 1, bad numbers in scan or map, and a locality of another map.
    """
    check_count("node_limit", node_limit)

    def search(problem: Problem, best: Best) -> None:
        _gcbb(problem, len(scan), node_limit, rivals, best)

    return searched(scan, landmarks, locality, confidence, min_pairings, search)


@compiled
def _gcbb(problem: Problem, m: int, node_limit: int, rivals: bool, best: Best) -> None:
    """The search for the pairings of `m` measurements; its answer is entered in `best`."""
    effort = problem.effort
    path = Path(np.empty(m, np.int64), np.empty(m, np.int64))
    # by level: the pairings above it, and the candidates tried
    above, tried = np.zeros(m + 1, np.int64), np.zeros(m + 1, np.int64)
    level = 0
    while level >= 0:
        p = above[level]
        if tried[level] == _STAR or p + m - level < fewest(best, rivals):
            level -= 1
            continue
        if level == m:
            effort[INDEX.leaves] += 1
            offer(best, problem, path, p)
            level -= 1
            continue
        feature, examined = next_branch(problem, path, p, level, tried[level])
        tried[level] = _STAR if feature == UNPAIRED else examined
        if feature == UNPAIRED and p + m - level - 1 < fewest(best, rivals):
            continue
        if must_end(effort, node_limit):
            break
        effort[INDEX.nodes] += 1
        if feature != UNPAIRED:
            path.measurements[p], path.features[p] = level, feature
            p += 1
        level += 1
        above[level], tried[level] = p, 0
